"""The console commands, a function each: thin covers over the package, which load the room that they call."""

from __future__ import annotations

import secrets
import sys
import webbrowser
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import fields
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from rich.console import Console
from rich.markup import escape
from rich.table import Table

from phnn.errors import InputRefused, PhnnError
from phnn.identification.plan import Options
from phnn.parameters import quantity
from phnn.recordings import Campaign, read
from phnn.results import PROGRESS, Place, claim, finite, printable, unique_names, watched

if TYPE_CHECKING:
    from phnn.diagnose.diagnosis import Diagnosis
    from phnn.identification.evaluate import Evaluation
    from phnn.inverse import Inverse
    from phnn.plot.signals import Plot
    from phnn.recordings.recording import Units
    from phnn.report.sections import Provenance

Config = Mapping[str, Any]
# A pipe has no width of its own: whole tables fit there.
_PIPE = 200


@contextmanager
def status() -> Iterator[Callable[[str], None]]:
    """Show a status line on a terminal; nothing in a pipe."""
    terminal = Console(stderr=True)
    if not terminal.is_terminal:
        yield lambda message: None
        return
    with terminal.status("reading") as status:
        yield status.update


@contextmanager
def refusals(name: str) -> Iterator[None]:
    """End a script with one line and the exit status of what went wrong."""
    try:
        yield
    except PhnnError as error:
        print(f"{name}: {error}", file=sys.stderr)
        sys.exit(error.exit_status)


def console(pipe: int = _PIPE) -> Console:
    """Return a console as wide as the terminal, or ``pipe`` letters where there is none."""
    terminal = Console()
    return terminal if terminal.is_terminal else Console(width=pipe)


def _doubt(campaign: Campaign) -> None:
    """Warn of wrong units and of outputs that are noise, before time is spent on them."""
    from phnn.check import doubts

    for sentence in doubts(campaign):
        print(f"warning: {printable(sentence)}", file=sys.stderr, flush=True)


def check(
    folder: Path, manifest: Path | None, out: Path | None = None, outside: bool = False, overwrite: bool = False
) -> None:
    """Print what was understood of a folder of recordings, what was noticed, and what they can show.

    Refuses what `identify` would refuse, with the same message; several inputs or outputs without a network are for
    `modes` and pass.
    """
    from phnn.check import check as check_recordings
    from phnn.identification.prepare import is_ready, prepare

    campaign = read(folder, manifest, allow_outside=outside)
    described = "network" in campaign.setup or is_ready(campaign)
    if described or not any(r.further or r.measures for r in campaign.recordings):
        prepare(campaign)
    checked = check_recordings(campaign)
    print(printable(str(checked), lines=True))
    if out is not None:
        from phnn.report.sections import write_check

        with claim(out, "check", [folder], ("check.json", "check.html"), overwrite=overwrite) as place:
            write_check(checked, place)


def template(folder: Path, out: Path | None, outside: bool = False) -> None:
    """Print a first manifest for a folder of unknown layout, or write it into a new file."""
    from phnn.template import look, write_new

    with status():
        text = look(folder, outside).text()
        if out is not None:
            write_new(out, text.encode())
    print(text.rstrip() if out is None else f"written: {out}; correct what is marked as guessed")


def open(
    folder: Path, manifest: Path | None, out: Path | None, port: int, browser: bool = True, outside: bool = False
) -> None:
    """Serve a page that leads from a folder to a verdict, until Ctrl-C."""
    from phnn.local_page import Work, serve
    from phnn.template import MANIFEST, look

    def tell(address: str) -> None:
        print(f"open {address} in a browser of this computer; Ctrl-C ends it", flush=True)
        if browser:
            webbrowser.open(address)

    place = out or Path("out") / folder.resolve().name
    serve(Work(look(folder, outside), manifest or folder / MANIFEST, place, outside), port, tell)


def identify(
    folder: Path, out: Path, manifest: Path | None, config: Config, outside: bool = False, overwrite: bool = False
) -> None:
    """Fit the base model; writes ``base/`` and ``identify.json``."""
    from phnn.report.formatting import interval

    options = Options.from_config(config)
    campaign = read(folder, manifest, allow_outside=outside)
    _doubt(campaign)
    with claim(out, "identify", [folder], ("base", "identify.json", PROGRESS), overwrite=overwrite) as place:
        content, scores = _identified(campaign, options, place)
    table = Table("parameter", "value", "standard error", "95 % interval", "note", title=f"base model of {folder}")
    for name, row in content["parameters"].items():
        error_text = f"{row['std']:.2g}" if row["std"] is not None else "–"
        value = f"{row['value']:.5g} {row['unit'] if row['unit'] != '1' else ''}".rstrip()
        table.add_row(name, value, error_text, interval(row["interval_95"]), str(row["held"] or ""))
    Console().print(table)
    if content["nothing"]:
        Console().print(f"[bold]{escape(content['nothing'])}[/bold].")
    if content["open"]:
        known = [f"{n} = {r['value']:.5g} ± {r['std']:.2g}" for n, r in content["ratios"].items()]
        Console().print(f"[bold]{escape(content['open'])}[/bold]. {escape(', '.join(known))}")
    table = Table("recording", "use", "base", title="fit %, and residual over noise")
    bare = {r.name for r in campaign.recordings if not r.noise_found}
    for part in scores.parts:
        use = "held out" if part.use == "confirmation" else "identified"
        over_noise = "–" if part.name.partition("[")[0] in bare else f"{part.residual_over_noise:.3g}"
        table.add_row(escape(part.name), use, f"{part.fit_percent:.2f}  {over_noise}")
    Console().print(table)


def _identified(campaign: Campaign, options: Options, place: Place) -> tuple[dict[str, Any], Evaluation]:
    """Fit the base model and write it; return the content of ``identify.json`` and the scores."""
    from phnn.diagnose.diagnosis import score_on_all
    from phnn.identification.base import identify_base
    from phnn.identification.identified import save_fit
    from phnn.integrate.cache import compile_ahead
    from phnn.network.roles import auxiliary

    with status() as tell, watched(place, "identify", tell) as progress:
        if compile_ahead():
            progress("compile the simulation, once on this machine")
        fitted, error = identify_base(campaign, options, progress)
        scores = score_on_all(fitted, campaign)
    save_fit(fitted, place / "base")
    hidden = auxiliary(fitted.setup.network)
    rows = fitted.estimates(n for n in fitted.setup.parameters if n not in hidden)
    content = {
        "parameters": {n: finite(row) | {"held": fitted.note(n) or None} for n, row in rows.items()},
        "nothing": fitted.nothing_statement(),
        "open": fitted.open_statement(),
        "ratios": {n: {"value": v, "std": finite(s)} for n, (v, s) in fitted.ratios().items()},
        "fit": scores.table(),
        "numerical_error_sigma": error.sigma,
        "seed": options.seed,
    }
    (place / "identify.json").write_json(content)
    return content, scores


def diagnose(
    folder: Path,
    out: Path,
    manifest: Path | None,
    config: Config,
    outside: bool = False,
    overwrite: bool = False,
    typed: Sequence[str] = (),
    budget: float | None = None,
) -> None:
    """Diagnose a folder; writes ``diagnosis.json``, ``report.html``, ``model/``, ``base/`` and ``figures/``.

    Raises:
        KeyboardInterrupt: the search was interrupted; what it had come upon is written.
    """
    from phnn.report.result import RESULTS
    from phnn.report.sections import command_line, provenance
    from phnn.rescue import deadline

    deadline(budget)
    options = Options.from_config(config)
    campaign = read(folder, manifest, allow_outside=outside)
    _doubt(campaign)
    with claim(out, "diagnose", [folder], RESULTS, overwrite=overwrite) as place:
        made_of = provenance(campaign, command_line(typed), manifest)
        diagnosis = _diagnosed(campaign, place, options, out, made_of, budget)
    if diagnosis.ended.interruption is not None:
        raise diagnosis.ended.interruption


def _diagnosed(
    campaign: Campaign, place: Place, options: Options, out: Path, made_of: Provenance, budget: float | None = None
) -> Diagnosis:
    """Diagnose, write what `diagnose` writes, and print it; ``out`` is the place as the user calls it."""
    # What draws the report is loaded now: an interruption in the middle of an import would leave half a module.
    import phnn.report.sections  # noqa: F401
    from phnn.diagnose.diagnosis import diagnose as run_diagnosis
    from phnn.identification.identified import save_fit
    from phnn.integrate.cache import compile_ahead
    from phnn.report.result import write_into
    from phnn.report.statements import summary

    with status() as tell, watched(place, "diagnose", tell) as progress:
        if compile_ahead():
            progress("compile the simulation, once on this machine")
        diagnosis = run_diagnosis(
            campaign, options, progress, on_base=lambda fit: save_fit(fit, place / "base"), budget=budget, answers=True
        )
        progress("write the report")
        write_into(diagnosis, place, made_of)
    Console(highlight=False).print(summary(diagnosis), markup=False)
    Console().print(f"report: {out / 'report.html'}   seed: {options.seed}")
    return diagnosis


# Members of a class beyond which it names nothing.
_CLASS = 3


def demo(seed: int | None, out: Path, config: Config, overwrite: bool = False) -> None:
    """Conceal an effect, seal it, diagnose the recordings, open the seal. Raises PhnnError where the sealed effect was
    neither named nor in a stated class of at most three."""
    from phnn.demo import EFFECTS, make, open_seal, seal
    from phnn.integrate.cache import compile_ahead
    from phnn.report.sections import command_line, provenance

    chosen = secrets.randbelow(10_000) if seed is None else seed
    compile_ahead()
    print(f"seed {chosen} (repeat with SEED={chosen}); one of {', '.join(EFFECTS)} is concealed", flush=True)
    with claim(out, "demo", (), ("recordings", "seal", "diagnosis"), overwrite=overwrite) as place:
        made = make(chosen)
        for name, content in made.files.items():
            (place / "recordings" / name).write(content)
        answer, digest = seal(made.sealed)
        sealed_file = place / "seal" / "sealed.json"
        sealed_file.write(answer)
        print(f"sealed the answer in {out / 'seal' / 'sealed.json'}, SHA-256 {digest}", flush=True)
        campaign, result = read(place.path / "recordings"), out / "diagnosis"
        # The seed that was drawn, where none was given: only so the command gives the same again.
        made_of = provenance(campaign, command_line(["demo", "--seed", str(chosen), "--out", str(out)]))
        diagnosis = _diagnosed(campaign, place / "diagnosis", Options.from_config(config), result, made_of)
    if diagnosis.ended.interruption is not None:
        raise diagnosis.ended.interruption
    sealed = open_seal(sealed_file.path, digest)
    claimed = diagnosis.outcome.claimed
    named = list(dict.fromkeys(c.name for c in claimed))
    members = list(dict.fromkeys([*named, *(e.title for c in claimed for e in c.alike)]))
    held = diagnosis.before.over_noise("confirmation"), diagnosis.after.over_noise("confirmation")
    print(f"opened the seal: {sealed.effect}, residual {sealed.strength_over_noise:.3g} × noise, {sealed.parameters}")
    print(f"held-out residual over noise: {held[0]:.3g} -> {held[1]:.3g}")
    words = ("+".join(named) or diagnosis.verdict, ",".join(members) or "-")
    print(f"sealed: {sealed.effect}  verdict: {diagnosis.verdict}  named: {words[0]}  class: {words[1]}", flush=True)
    if sealed.effect not in named and not (sealed.effect in members and len(members) <= _CLASS):
        raise PhnnError(f"the sealed effect {sealed.effect} was not found; see {out / 'diagnosis' / 'report.html'}")


def compare(
    folder: Path, out: Path, manifest: Path | None, config: Config, outside: bool = False, overwrite: bool = False
) -> None:
    """Fit several kinds of model to a folder; see `phnn.comparison.models.compare` for what it writes."""
    from phnn.comparison.models import Settings, show
    from phnn.comparison.models import compare as run_comparison

    settings = Settings.from_config(config)
    with status() as progress:
        campaign = read(folder, manifest, allow_outside=outside)
        results = run_comparison(campaign, out, settings, progress, overwrite)
    show(results, console())
    print(f"results: {out / 'compare.md'}   seed: {settings.options.seed}")


def modes(
    folder: Path, out: Path, manifest: Path | None, config: Config, outside: bool = False, overwrite: bool = False
) -> None:
    """Find the modes of a structure and what moves with amplitude; see `phnn.modal.study` for what it writes."""
    from phnn.modal.experiment import study_of
    from phnn.modal.study import RESULTS, Settings, show, study_modes, write_modes

    settings = Settings.from_config(config)
    study = study_of(read(folder, manifest, allow_outside=outside))
    with claim(out, "modes", [folder], RESULTS, overwrite=overwrite) as place, status() as progress:
        result = study_modes(study, settings, progress)
        progress("write the report")
        write_modes(result, str(folder), place)
    show(result, console())
    print(f"report: {out / 'report.html'}")


def train(config: Config) -> None:
    """Train a model on a folder; see `phnn.learn.run.train_folder` for what it writes."""
    from phnn.learn import Settings, train_folder

    settings = Settings.from_config(config)
    with status() as progress:
        content = train_folder(settings, progress)
    table = Table("recording", "use", "fit %", "residual over noise", title=f"{settings.named}, trained")

    def with_spread(row: Mapping[str, Any], key: str, form: str) -> str:
        """Return a figure, with its standard deviation over several seeds."""
        spread = row.get(f"{key}_spread")
        return f"{row[key]:{form}}" + ("" if spread is None else f" ± {spread:.2g}")

    for name, row in content["recordings"].items():
        use = "held out" if row["held_out"] else "stopped the training" if row["validation"] else "trained on"
        scores = with_spread(row, "fit_percent", ".2f"), with_spread(row, "residual_over_noise", ".3g")
        table.add_row(escape(name), use, *scores)
    Console().print(table)
    seeds = settings.seeds or (settings.seed,)
    Console().print(f"results: {settings.home}   seed: {', '.join(map(str, seeds))}")


def predict(
    model: Path, folder: Path, out: Path, manifest: Path | None, outside: bool = False, overwrite: bool = False
) -> None:
    """Simulate the recordings of a folder with a stored model; writes one ``NAME.csv`` per recording and
    ``predict.json`` with fit %, RMSE and residual over noise wherever the output was recorded.

    Where the input jumps between two samples, a further column says how uncertain that makes the output.
    """
    from phnn.prediction import document
    from phnn.predictor import load, predictions

    loaded = load(model, outside)
    campaign = read(folder, manifest, need_output=False, allow_outside=outside)
    files, entries = unique_names((r.name for r in campaign.recordings), ".csv"), []
    results = (*files.values(), "predict.json")
    with claim(out, "predict", [model, folder], results, overwrite=overwrite) as place:
        for one in predictions(loaded, campaign):
            name = files[one.recording.name]
            (place / name).write(one.table.to_csv(index=False).encode())
            entries.append(one)
            print(out / name)
        content = document(entries, files, printable(str(model)))
        (place / "predict.json").write_json(content)
    if content["totals"]:
        console().print(_score_table(content))
    print(f"results: {out / 'predict.json'}")


def _score_table(content: Mapping[str, Any]) -> Table:
    """Return a table of ``predict.json``, by recording and in total; a dash where a figure is undefined."""
    from phnn.report.formatting import DASH, percent, ratio

    def cells(row: Mapping[str, Any]) -> tuple[str, str, str]:
        rmse = DASH if row["rmse"] is None else quantity(row["rmse"], row["unit"])
        return percent(row["fit_percent"], 2), rmse, ratio(row["residual_over_noise"])

    note = "Zero and initial state come from the first samples; a fit, as in a report, takes them from all that it has."
    table = Table("recording", "use", "fit %", "RMSE", "residual over noise", caption=note)
    for name, row in content["recordings"].items():
        if row["samples"]:
            table.add_row(escape(name), "held out" if row["held_out"] else DASH, *cells(row))
    table.add_section()
    for name, row in content["totals"].items():
        table.add_row(f"{name.replace('_', ' ')} ({row['recordings']})", "", *cells(row))
    return table


def export(model: Path, out: Path, options: Mapping[str, Any], outside: bool = False, overwrite: bool = False) -> None:
    """Write a stored model as files of a target, and print their names; options are those of
    `phnn.exporting.write.program_of`."""
    from phnn.exporting.write import program_of, write
    from phnn.predictor import load

    taken = ("to", "dt", "substeps", "hold", "name", "ports", "sensor", "initial_input")
    program = program_of(load(model, outside), **{name: options[name] for name in taken})
    for path in write(program, options["to"], out, [model], overwrite):
        print(path)


# What `phnn invert` writes into its folder.
_INVERSE = ("command.csv", "invert.json", "invert.png")
# By the unit of an input: what it is called in the head of a table.
_INPUTS = {"V": "voltage_V", "N": "force_N"}


def invert(
    model: Path, reference: Path, out: Path, options: Mapping[str, Any], outside: bool = False, overwrite: bool = False
) -> None:
    """Find the command with which a stored model follows the reference of a file; writes its table, json and figure.

    Options are the fields of `phnn.inverse.InverseOptions`; None stands for the default.
    """
    from phnn.inverse import InverseOptions
    from phnn.model import Model
    from phnn.predictor import load
    from phnn.recordings.checks import like_an_actuator
    from phnn.recordings.recording import ACTUATOR, Units
    from phnn.recordings.table import Where

    given = {f.name: options[f.name] for f in fields(InverseOptions) if options.get(f.name) is not None}
    if "limits" in given:
        given["limits"] = tuple(given["limits"])
    smooth = InverseOptions(**given).smooth
    loaded = load(model, outside)
    if not isinstance(loaded, Model):
        raise InputRefused(
            f"{model}: a model of modes in a steady cycle has no inverse: give the model of an actuator, as phnn "
            "identify or phnn diagnose writes it"
        )
    network, (t, y, unit, notes) = loaded.setup.network, _reference(reference, outside)
    measured = next(s.unit for s in network.storages if s.name == network.output)
    units = Units(next((p.unit for p in network.ports), ""), measured)
    if unit != units.output:
        raise InputRefused(
            f"{reference.name}: the reference is in {unit}, the output of the model in {units.output}: give a "
            "reference of what the model's sensor measures"
        )
    if units == ACTUATOR:
        like_an_actuator(float(np.ptp(y)), "displacement", "reference", Where(reference.name))
    with claim(out, "invert", [model, reference], _INVERSE, overwrite=overwrite) as place:
        inverse = loaded.inverse(t, y, **given)
        _write_inverse(inverse, units, notes, place)
    low, high = float(inverse.voltage.min()), float(inverse.voltage.max())
    print(f"command: {low:.4g} to {high:.4g} {units.input}")

    def size(error: np.ndarray) -> str:
        rms = float(np.sqrt(np.mean(error**2)))
        return f"at most {quantity(float(np.abs(error).max()), units.output)}, {quantity(rms, units.output)} rms"

    if smooth is None:
        print(f"error of the model: {size(inverse.error)}")
    else:
        print(f"error of the model against the smoothed reference: {size(inverse.error)}")
        print(f"against the reference itself: {size(inverse.error_of_given)}")
    for message in (*notes, *inverse.messages):
        print(message)
    print(f"results: {out / _INVERSE[0]}")


def _reference(path: Path, outside: bool) -> tuple[np.ndarray, np.ndarray, str, tuple[str, ...]]:
    """Return (N,) equally spaced time [s], (N,) what is to be followed [SI] with its unit, and what was done to the
    samples, from a table of any format that recordings may have."""
    from phnn.intake import named_file
    from phnn.recordings import checks
    from phnn.recordings.channels import evenly, select, stamped
    from phnn.recordings.reader import read_table

    table = read_table(named_file(path, (path.parent,), outside=outside))
    channels, _ = select(table, {}, {})
    name = "displacement" if "displacement" in channels else "output"
    columns = ", ".join(n for n in table.names if n) or "none with a name"
    for wanted, known, example in (("time", "time", "time_s"), ("displacement", name, "displacement_um")):
        if known not in channels:
            raise InputRefused(f"{table.where}: no {wanted} column among its columns ({columns}): name one {example}")
    channel, time = channels[name], channels["time"]
    checks.enough_samples(channel.values.size, table.where)
    checks.output_moves(channel.values, f"{name} ({channel.label})", table.where)
    times = stamped(time.values, time.factor, {name: channel.values}, table.where)
    dt, y = evenly(times.t, times.values[name])
    notes = tuple(f"The reference: {note}." for note in times.notes)
    return time.values[0] + dt * np.arange(y.size), y, channel.si, notes


def _write_inverse(inverse: Inverse, units: Units, notes: tuple[str, ...], place: Place) -> None:
    """Write the command and what it reaches as a table, as json and as a figure of output, error and command."""
    import pandas as pd
    from matplotlib import rc_context

    from phnn.report.figures import draw_trace
    from phnn.report.figures.style import AFTER, BEFORE, FAINT, MEASURED, RC, finish, new_figure, png
    from phnn.report.formatting import display_unit

    suffix = units.output.replace(" ", "")
    table = pd.DataFrame(
        {
            "time_s": inverse.t,
            _INPUTS.get(units.input, f"input_{units.input.replace(' ', '')}"): inverse.voltage,
            f"{'displacement' if units.output == 'm' else 'output'}_{suffix}": inverse.reached,
            f"reference_{suffix}": inverse.reference,
            f"error_{suffix}": inverse.error,
            **({} if inverse.options.smooth is None else {f"given_{suffix}": inverse.given}),
        }
    )
    (place / _INVERSE[0]).write(table.to_csv(index=False).encode())
    content = inverse.document()
    (place / _INVERSE[1]).write_json({**content, "messages": [*notes, *content["messages"]]})
    with rc_context(RC):
        figure = new_figure(9.6, 6.6)
        outputs, errors, commands = figure.subplots(3, 1, sharex=True)
        unit = display_unit(float(abs(inverse.reference).max()), units.output)
        fine = display_unit(float(abs(inverse.error).max()), units.output)
        draw_trace(outputs, inverse.t, inverse.reference, unit.scale, color=MEASURED, linewidth=3.0, label="reference")
        draw_trace(
            outputs, inverse.t, inverse.reached, unit.scale, color=AFTER, linewidth=1.1, label="reached by the model"
        )
        draw_trace(errors, inverse.t, inverse.error, fine.scale, color=AFTER, linewidth=1.0)
        for stretch in inverse.missed:
            if stretch.causes:
                errors.axvspan(stretch.start, stretch.end, color=BEFORE, alpha=0.12, linewidth=0.0)
        draw_trace(commands, inverse.t, inverse.voltage, color=AFTER, linewidth=1.1)
        for limit in inverse.options.limits or ():
            commands.axhline(limit, color=FAINT, linewidth=1.0)
        finish(outputs, "", f"output ({unit.name})", None)
        finish(errors, "", f"error ({fine.name})", None)
        finish(commands, "time (s)", f"command ({units.input})", None)
        figure.legend(*outputs.get_legend_handles_labels(), loc="outside upper right", ncols=2)
        (place / _INVERSE[2]).write(png(figure))


# Endings of the tables' names, of all kinds of plot.
_TABLES = ("", "_spectrum", "_measured")
# Frequencies between the two that are given.
_POINTS = 40


def plot(
    kind: str,
    model: Path,
    folder: Path | None,
    out: Path,
    options: Mapping[str, Any],
    outside: bool = False,
    overwrite: bool = False,
) -> None:
    """Draw one kind of plot; writes ``KIND.svg`` and its data, ``KIND.csv``, and of some kinds a further table.

    Options are ``manifest``, ``recording``, ``frequencies`` and ``amplitude`` of the command line; a response with the
    last two needs no folder.
    """
    from phnn.plot.signals import MOST
    from phnn.predictor import model_of
    from phnn.report.figures.style import svg
    from phnn.report.page import literal_text

    for name in ("recording",) if kind == "bode" else ("frequencies", "amplitude"):
        if options[name] is not None:
            raise InputRefused(f"phnn plot {kind} does not take --{name}: leave it out")
    recording = options["recording"]
    if kind == "energy" and recording is not None and len(recording) > 1:
        raise InputRefused("phnn plot energy draws one recording: give --recording once")
    inputs, files = [model] if folder is None else [model, folder], [f"{kind}.svg"]
    results = (f"{kind}.svg", *(f"{kind}{end}.csv" for end in _TABLES))
    with claim(out, "plot", inputs, results, overwrite=overwrite) as place, status():
        campaign = None if folder is None else read(folder, options["manifest"], allow_outside=outside)
        drawn = _plotted(kind, model_of(model, outside), campaign, options)
        count = 0 if campaign is None or recording else len(campaign.recordings)
        if kind in ("compare", "residuals", "loops") and count > MOST:
            print(f"at most {MOST} of {count} recordings are drawn: choose others with --recording NAME")
        (place / f"{kind}.svg").write(svg(drawn.figure()))
        for end, table in drawn.tables.items():
            files.append(f"{kind}{end}.csv")
            safe = table.map(lambda value: literal_text(value) if isinstance(value, str) else value)
            (place / files[-1]).write(safe.to_csv(index=False).encode())
    for name in files:
        print(out / name)


def _plotted(kind: str, simulator: Any, campaign: Campaign | None, options: Mapping[str, Any]) -> Plot:
    from phnn.plot.frequency import residual_tests, response, whiteness
    from phnn.plot.signals import balance, chosen, hysteresis, network_model, outputs
    from phnn.trajectory import simulate

    recording = options["recording"]
    if kind == "bode":
        frequencies = options["frequencies"]
        if frequencies is not None:
            low, high = frequencies
            if not 0.0 < low < high < np.inf:
                raise InputRefused(
                    f"--frequencies {low:g} {high:g}: give the lowest and the highest, both positive [Hz]"
                )
            frequencies = np.geomspace(low, high, _POINTS)
        return response(simulator, frequencies, options["amplitude"], campaign=campaign).plot()
    if campaign is None:
        raise InputRefused(f"phnn plot {kind}: no recordings: name their folder after that of the model")
    if kind == "compare":
        return outputs(simulator, campaign, recording)
    if kind == "residuals":
        return whiteness(residual_tests(simulator, campaign, recording))
    if kind == "loops":
        return hysteresis(simulator, campaign, recording)
    model = network_model(simulator)
    return balance(simulate(model.setup, chosen(campaign, recording).recordings[0], model.substeps)).plot()

"""A methods paragraph for a paper, and where a run came from: command line, versions, seed, hashes."""

from __future__ import annotations

import platform
import re
import shlex
from collections.abc import Sequence
from importlib.metadata import version
from pathlib import Path

from phnn.diagnose.diagnosis import Diagnosis
from phnn.network.roles import auxiliary
from phnn.recordings import Campaign
from phnn.recordings.stored import digest
from phnn.report.evidence import FileHash, Methods, Provenance
from phnn.report.formatting import listing, number, ratio, short, words
from phnn.results import printable, sha256_of

_MANIFEST = "recordings.yaml"


def command_line(typed: Sequence[str]) -> str:
    """The command as one line for a shell; empty where nothing was typed."""
    return printable(shlex.join(["phnn", *typed])) if typed else ""


def provenance(campaign: Campaign, command: str = "", manifest: Path | None = None) -> Provenance:
    """Hash the files of a campaign; call it soon after they were read. Files that are gone have no hash.

    Args:
        command: how the run was started, see `command_line`.
        manifest: where the manifest lies, if not in the folder.
    """
    folder = Path(campaign.folder)
    names = dict.fromkeys(name for r in campaign.recordings for name in r.source.split(", ") if name)
    found = (_hashed(folder / name, name) for name in names)
    said = manifest if manifest is not None else folder / _MANIFEST
    return Provenance(
        command,
        campaign.folder,
        tuple(f for f in found if f is not None),
        _hashed(said, printable(str(manifest) if manifest is not None else _MANIFEST)),
        digest(campaign),
    )


def _hashed(path: Path, name: str) -> FileHash | None:
    try:
        return FileHash(name, sha256_of(path)) if path.is_file() else None
    except (OSError, ValueError):
        return None


# Names of recordings that are listed; of more, the number is said.
_LISTED = 16
_PAPER_SHORT = (
    "Díaz, Ramírez, Le Gorrec & Wu, Modular Passivity-Based Modeling of Piezoelectric Actuators, Mathematical and "
    "Computer Modelling of Dynamical Systems 31 (1), 2025, doi:10.1080/13873954.2025.2533294"
)
_COARSENED = (
    "Miller & Dunson, Robust Bayesian inference via coarsening, Journal of the American Statistical Association 114, "
    "2019, doi:10.1080/01621459.2018.1469995"
)
_SCHWARZ = "Schwarz, Estimating the dimension of a model, The Annals of Statistics 6 (2), 1978"
_PAPER = """@article{diaz_modular,
  author  = {D{\\'i}az, Ignacio and Ram{\\'i}rez, H{\\'e}ctor and {Le Gorrec}, Yann and Wu, Yongxin},
  title   = {Modular Passivity-Based Modeling of Piezoelectric Actuators},
  journal = {Mathematical and Computer Modelling of Dynamical Systems},
  volume  = {31},
  number  = {1},
  year    = {2025},
  doi     = {10.1080/13873954.2025.2533294},
}"""
# What BibTeX takes for its own, as LaTeX writes it.
_ESCAPES = str.maketrans({"\\": r"\textbackslash{}"} | {letter: f"\\{letter}" for letter in "{}&%#_$"})


def methods(diagnosis: Diagnosis) -> Methods:
    """Describe a finished diagnosis as the methods section of a paper would."""
    packages = ", ".join(f"{name} {version(name)}" for name in ("numpy", "scipy", "numba"))
    software = f"Software: phnn {version('phnn')} [1] with Python {platform.python_version()}, {packages}."
    sentences = (*_fitted(diagnosis), *_held_out(diagnosis), *_decided(diagnosis), *_found(diagnosis), software)
    references = _references(diagnosis)
    return Methods(sentences, (f"phnn {version('phnn')}", _PAPER_SHORT, *references), bibtex(references))


def _references(diagnosis: Diagnosis) -> tuple[str, ...]:
    """Return those of the number of a model, and those of the elements."""
    return (_COARSENED, _SCHWARZ, *dict.fromkeys(r for c in diagnosis.claims for r in c.effect.references))


def bibtex(references: Sequence[str]) -> str:
    """Entries for the software, the paper of its model, and references that are kept as text."""
    software = (
        f"@software{{phnn,\n  author  = {{{{phnn contributors}}}},\n  title   = {{phnn: port-Hamiltonian models of "
        f"piezoelectric actuators, and the physics they leave out}},\n  version = {{{version('phnn')}}},\n}}"
    )
    entries = [_entry(i + 1, text) for i, text in enumerate(references)]
    return "\n\n".join([software, _PAPER, *entries]) + "\n"


def _entry(place: int, text: str) -> str:
    year = re.search(r"\b(1[89]|20)\d\d\b", text)
    dated = f"\n  year = {{{year[0]}}}," if year else ""
    return f"@misc{{reference_{place},\n  note = {{{text.translate(_ESCAPES)}}},{dated}\n}}"


def _names(names: Sequence[str]) -> str:
    return f"{len(names)} recordings" if len(names) > _LISTED else listing(names)


def _fitted(diagnosis: Diagnosis) -> list[str]:
    base, parts = diagnosis.base, [p for r in diagnosis.campaign.recordings for p in r.parts]
    network = base.setup.network
    names = [p.name for p in parts if p.use == "identification"]
    fitted = [n for n in base.variables.names if n not in auxiliary(network)]
    held = [n for n in base.held if n not in fitted and n not in auxiliary(network)]
    found = [
        f"The base model is the network “{words(base.setup.name)}” with "
        f"{len(network.storages)} storages; its {len(fitted)} parameters ({', '.join(fitted)}) were estimated by "
        f"bounded nonlinear least squares on {_names(names)} [1, 2].",
        "Residuals were weighted by the noise floor of each recording, and zero and initial state of a recording were "
        "estimated with the parameters where they were unknown.",
    ]
    if held:
        found.append(f"Held at stated or initial values: {', '.join(held)}.")
    found.append(
        "Sub-steps of the power-preserving discretisation kept the numerical error at "
        f"{number(diagnosis.error.sigma, 2)} noise standard deviations over all recordings together."
    )
    return found


def _held_out(diagnosis: Diagnosis) -> list[str]:
    names = [p.name for p in diagnosis.before.parts if p.use == "confirmation"]
    if not names:
        return ["No recording was held out: the scores describe the fit and not a prediction."]
    new = "bring" if len(names) > 1 else "brings"
    negated = "do not bring" if len(names) > 1 else "does not bring"
    brought = new if diagnosis.campaign.held_out_is_new else negated
    return [
        f"Held out were {_names(names)}: no model was fitted to them or weighed by them." if len(names) > 1
        else f"Held out was {names[0]}: no model was fitted to it or weighed by it.",
        f"{'They' if len(names) > 1 else 'It'} {brought} an amplitude or frequency that the others lack.",
    ]  # fmt: skip


def _decided(diagnosis: Diagnosis) -> list[str]:
    c = diagnosis.criteria
    sentences = [
        f"For each of {len(diagnosis.screened[0])} candidate elements, the fall of χ² was predicted from one "
        "linearisation of the model, with all fitted parameters projected out; its standard deviation was taken from "
        "blocks of the residual, whatever the colour of the noise.",
        f"Candidates above {short(c.score)} standard deviations that explain more than {short(c.material)} of the "
        f"noise were added and refitted, one element at a time, {diagnosis.options.max_effects} at most; "
        f"{len(diagnosis.visited.models)} models were fitted.",
        "Models were weighed by a coarsened likelihood of the fitted recordings [3], in which none "
        "counts for more samples than the misfit of the best model allows, and by the price of their parameters [4]; "
        "the probability of an effect is the share of all models that hold it, times the probability that the "
        "catalogue holds all physics.",
        f"An effect is named from a probability of {short(c.proven)} on, if the error of held-out recordings falls "
        f"with it. The catalogue is taken to be complete where a model of effects alone leaves at most "
        f"{short(c.explained)} times the power of the noise, or where no candidate promises a gain.",
    ]
    if changed := c.changed():
        sentences.append(
            f"Criteria changed from their defaults: {', '.join(f'{n} = {short(v)}' for n, v in changed.items())}."
        )
    return sentences


def _found(diagnosis: Diagnosis) -> list[str]:
    # Numbers of references in brackets, after those of software and paper.
    known, elements = _references(diagnosis), []
    for c in diagnosis.claims:
        numbers = ", ".join(str(known.index(r) + 3) for r in c.effect.references)
        elements.append(words(c.effect.name) + (f" [{numbers}]" if numbers else ""))
    added = f"the final model adds {listing(elements)}" if elements else "nothing was added to the base model"
    before, after = (e.over_noise("confirmation") for e in (diagnosis.before, diagnosis.after))
    change = f"; on held-out recordings the residual goes from {ratio(before)} to {ratio(after)} times the noise"
    floors = before == before and all(r.noise_found for r in diagnosis.campaign.recordings)
    return [f"The verdict is “{diagnosis.verdict}”: {added}{change if elements and floors else ''}."]

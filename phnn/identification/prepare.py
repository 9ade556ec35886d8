"""Everything of an identification that can be refused before it begins."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from phnn.errors import InputRefused, StructureViolated
from phnn.identification.order import MOST_HYSTERONS
from phnn.identification.plan import Plan
from phnn.identification.staged import check_known, held_by_statement
from phnn.identification.starting_points import mechanical_points
from phnn.identification.zero import is_shared, with_unknown_gain
from phnn.integrate.program import compile_network
from phnn.models.actuator import hrc
from phnn.models.bouc_wen import bouc_wen
from phnn.models.network_file import load_network
from phnn.recordings.recording import Campaign, Recording
from phnn.results import printable
from phnn.setup import Setup
from phnn.trajectory import check_names


def identification_plan(campaign: Campaign, workers: int) -> Plan:
    """The recordings with identification samples.

    Raises:
        InputRefused: there are none.
    """
    chosen = tuple(r for r in campaign.recordings if r.mask("identification").any())
    if not chosen:
        raise InputRefused("no recording is for identification: set `use: identification` for some in recordings.yaml")
    return Plan(chosen, {}, workers, {n: a.std for n, a in campaign.known.items()})


@dataclass(frozen=True)
class Prepared:
    """What a fit begins with, once nothing in the manifest can be refused any more.

    Attributes:
        plan: the recordings with identification samples.
        model: by name; ``network`` where a file describes it.
        hysterons: of an actuator, or the form of another hysteresis; None where the recordings are to say.
        described: the network of that file.
    """

    plan: Plan
    model: str
    hysterons: int | str | None
    described: Setup | None = None


def prepare(campaign: Campaign, workers: int = 1) -> Prepared:
    """Everything of an identification that can be refused before it begins.

    Raises:
        InputRefused: no recording to identify from, a network that cannot be built or simulated, ports or outputs that
            it does not have, anchors of parameters that the model does not have or that cannot have the value, several
            inputs for a model of one.
    """
    plan = identification_plan(campaign, workers)
    is_shared(campaign.recordings)
    if "network" in campaign.setup:
        return Prepared(plan, "network", 0, _described(campaign))
    gain_known(campaign.recordings)
    single(campaign.recordings, "this model has one input and one output")
    displacement_shown(campaign.recordings)
    model = str(campaign.setup.get("model", "piezo_actuator"))
    stated = campaign.setup.get("hysterons") if model in ("piezo_actuator", "hrc") else 0
    hysterons = None if stated in (None, "auto") else stated
    most = hysterons if isinstance(hysterons, int) else MOST_HYSTERONS if hysterons is None else 0
    parameters = bouc_wen().parameters if model == "bouc_wen" else hrc(most).parameters
    check_known(campaign.known, parameters)
    held_by_statement(campaign.known)
    mechanical_points(plan, {n: a.value for n, a in campaign.known.items()})
    return Prepared(plan, model, hysterons)


def _described(campaign: Campaign) -> Setup:
    """The network of the manifest, a file or a setup, with its anchors."""
    given = campaign.setup["network"]
    path = Path(given.name if isinstance(given, Setup) else str(given))
    setup = given if isinstance(given, Setup) else Setup(load_network(path), name=printable(path.stem))
    check_names(setup.network, campaign.recordings)
    check_known(campaign.known, setup.parameters)
    try:
        setup = setup.with_values({n: a.value for n, a in campaign.known.items()})
        compile_network(setup.network)
    except StructureViolated as error:
        raise InputRefused(f"{printable(path.name)}: {error}") from error
    if not setup.network.ports:
        raise InputRefused(f"{printable(path.name)}: no source for the recorded input: add an element of type Se or Sf")
    return with_unknown_gain(setup, campaign.recordings)


def single(recordings: Sequence[Recording], why: str) -> None:
    """Refuse recordings of several inputs or outputs.

    Raises:
        InputRefused: names one.
    """
    several = [r.source for r in recordings if r.further or r.measures]
    if several:
        raise InputRefused(
            f"{several[0]}: several inputs or outputs (`ports`, `outputs` in recordings.yaml), but {why}: describe the "
            f"system as a network and use phnn check, identify and predict, or give one input and one output"
        )


def gain_known(recordings: Sequence[Recording]) -> None:
    """Refuse an unknown gain where the model has one of its own, the transducer's.

    Raises:
        InputRefused: names a recording.
    """
    unknown = [r.source for r in recordings if r.gain == "unknown"]
    if unknown:
        raise InputRefused(
            f"{unknown[0]}: gain: unknown: this model's transducer ratio takes up any factor of the input already, "
            f"leave `gain` out; electrical values then hold for the recorded numbers as volts"
        )


def displacement_shown(recordings: Sequence[Recording]) -> None:
    """Refuse sensors of the velocity, from which the stages of an actuator's identification cannot begin.

    Raises:
        InputRefused: names one.
    """
    rates = [r.source for r in recordings if r.sensor.derivative]
    if rates:
        raise InputRefused(
            f"{rates[0]}: its sensor measures a velocity (`sensor: {{derivative: true}}`), but this model is "
            f"identified from displacements: describe the actuator as a network, setup: {{network: FILE.yaml}}"
        )

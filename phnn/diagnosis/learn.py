"""Fit the learned one-port of a location where no element of the catalogue explains the mismatch.

The one-ports are those of `phnn.effects.learned`: a spring, a damper, a relaxation.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from phnn.criteria import REFITS
from phnn.diagnose.linearised import LinearisedFit
from phnn.diagnosis.strengths import started
from phnn.effects import Kind, Scales
from phnn.effects.learned import learned_elements
from phnn.effects.places import attached
from phnn.identification.fit import Fit, fit, variables_from
from phnn.identification.problem import Problem
from phnn.rescue import attempt
from phnn.setup import Setup


def learned_setup(setup: Setup, kind: Kind, scales: Scales) -> Setup | None:
    """The setup with the learned element of a kind at small strengths; None if there is no element of that kind."""
    generic = learned_elements().get(kind.learned)
    element = None if generic is None else attached(generic, setup)[0]
    if element is None or not element.can_be_added_to(setup):
        return None
    return replace(element.add_to(setup, element.grid(scales)[0]), name=f"{setup.name}+learned")


def learn(linearised: LinearisedFit, kind: Kind) -> Fit | None:
    """Fit the learned element together with the base parameters; None where the location has no passive one-port."""
    setup = learned_setup(linearised.fit.setup, kind, linearised.scales)
    if setup is None:
        return None
    base, plan, template = linearised.fit, linearised.plan, setup
    own = [n for n in template.free if n not in base.setup.parameters]

    def fitted() -> Fit:
        used = touched(base, template, own)
        names = [*base.variables.names, *used]
        begun = started(template, plan, names, used, base, REFITS.longest_step)
        return fit(begun, plan, names, base.held, 60, origin=base)

    return attempt(f"fit with the learned element of kind {kind.name}", fitted, None)


def touched(base: Fit, setup: Setup, names: Sequence[str]) -> list[str]:
    """Those of the named parameters on which some output depends.

    A spring beyond the motion that was recorded has none. An optimiser may carry it anywhere within its bounds, and the
    model would push with any force where nothing was recorded.

    Args:
        base: fit without the element, for its recordings and initial states.
        setup: with the element.
        names: parameters of the element.

    Raises:
        SolverFailed: the setup cannot be simulated.
    """
    problem = Problem(setup, base.plan, variables_from(setup, base.plan, names, base))
    slopes = problem.jacobian(problem.variables.start(setup))[:, : len(names)]
    return [n for n, used in zip(names, np.any(slopes != 0.0, axis=0), strict=True) if used]

"""The base model of an actuator whose true parameters are known: the fit of a tool that finds the best optimum."""

from __future__ import annotations

from phnn.identification.fit import Fit
from phnn.identification.plan import Plan
from phnn.identification.refinement import with_bounded_error
from phnn.identification.staged import fit_identified, held_by_statement
from phnn.recordings import Anchor
from studies.benchmark.fingerprints.actuators import Actuator

# Simulations before the sub-steps are chosen; bound on the numerical error, as `phnn.identification.options.Options`
# has it.
_FIRST, _BOUND = 15, 1.0


def fitted(actuator: Actuator) -> Fit:
    """The base model from its true parameters: one start instead of many, as nothing has to be searched.

    Raises:
        PhnnError: it cannot be simulated.
    """
    plan = Plan(actuator.recordings, {}, 1)
    first = fit_identified(actuator.setup, plan, held_by_statement({"m": Anchor(actuator.mass)}), _FIRST)
    return with_bounded_error(first, _BOUND)[0]

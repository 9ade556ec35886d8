"""A classifier that was trained on the generator of the benchmark's own actuators, as a tool.

The base model is fitted to all samples, what it leaves becomes a vector of features, and a forest that has seen
hundreds of such vectors states probabilities (`studies.benchmark.fingerprints`). It never simulates an effect for
its claims. For the predictions the effects that it claims are added to the base model and fitted, as
`studies.benchmark.tools.stepwise` does.

It knows more than any tool for real recordings can know: the ranges of all parameters, the shares of the groups, the
other laws, and the effects outside the catalogue, all drawn from the same distributions as the cases.
"""

from __future__ import annotations

from collections.abc import Mapping
from functools import lru_cache
from pathlib import Path

from phnn.diagnosis.diagnosis import available
from phnn.diagnosis.linearised_fit import prepare
from phnn.identification.fit import Fit
from phnn.identification.identified import model_of
from phnn.recordings import Campaign
from studies.benchmark.answer import CLAIMED, NONE, UNLISTED, Answer
from studies.benchmark.fingerprints.classifier import Classifier, trained
from studies.benchmark.fingerprints.features import features
from studies.benchmark.fingerprints.training import read_table
from studies.benchmark.tools.common import base_of, bic, places_of, predictions, refitted, tried

# Effects that a prediction uses at most.
_MOST = 2


def answer(folder: Path, seed: int, training: Path, kind: str = "trees") -> Answer:
    """State what the fingerprint of a case looks like.

    Args:
        training: what ``phnn bench train`` has written.
        kind: of classifier, see `studies.benchmark.fingerprints.classifier.KINDS`.
    """
    base = base_of(folder, seed, everything=True)
    stated = classifier(training, kind).probabilities(features(base.fit))
    names = {name: p for name, p in stated.items() if name not in (NONE, UNLISTED)}
    extended = _extended(base.fit, base.campaign, _wanted(stated))
    return Answer(
        names,
        stated[NONE],
        stated[UNLISTED],
        places=places_of(names),
        predictions=predictions(model_of(extended), folder),
    )


@lru_cache(maxsize=2)
def classifier(training: Path, kind: str) -> Classifier:
    """The classifier of a training; fitted once in a process."""
    return trained(read_table(training), kind, 0)


def _wanted(stated: Mapping[str, float]) -> list[str]:
    """Names for the prediction: all claims, else the most probable one, where it is more probable than nothing."""
    names = sorted((n for n in stated if n not in (NONE, UNLISTED)), key=lambda n: -stated[n])
    claimed = [n for n in names if stated[n] >= CLAIMED][:_MOST]
    if claimed or stated[NONE] >= stated[names[0]]:
        return claimed
    return names[:1]


def _extended(base: Fit, campaign: Campaign, wanted: list[str]) -> Fit:
    """The base model with the wanted effects, each as far as Schwarz's criterion falls."""
    current = base
    for name in wanted:
        scales = prepare(current).scales
        each = [tried(current, e, scales) for e in available(campaign, current.setup) if e.canonical == name]
        ends = [f for f in each if f is not None]
        if ends:
            found = refitted(current, min(ends, key=bic))
            current = found if bic(found) < bic(current) else current
    return current

"""
First diagnosis
===============

Read recordings, fit the actuator of the paper, and ask what it leaves out.

The recordings are simulated here: four files of an actuator in which one effect is concealed. With a folder of your
own, begin at ``phnn.read``.
"""

# %%
# Recordings
# ----------
# The generator shares no code with the models. It draws an actuator, the strength of the effect and the noise from
# the seed.

import tempfile
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np

import phnn
from phnn.check import check
from phnn.demo import generate

folder = Path(tempfile.mkdtemp())
sealed = generate(7, folder / "recordings", "quadratic_drag", "short")
campaign = phnn.read(folder / "recordings")

figure, axes = plt.subplots(1, len(campaign.recordings), figsize=(11, 2.8), layout="constrained")
for panel, recording in zip(axes, campaign.recordings, strict=True):
    panel.plot(recording.u, 1e6 * recording.y, linewidth=0.8)
    panel.set(title=recording.name, xlabel="voltage [V]")
_ = axes[0].set_ylabel("displacement [µm]")

# %%
# What can they show?
# -------------------
# The noise floor comes from the recordings, never from the fit. The list says what else could be told apart.

for recording in campaign.recordings:
    print(f"{recording.name}: noise {1e9 * recording.noise:.0f} nm from {recording.noise_source}")
for ability in check(campaign).abilities:
    print("yes" if ability.able else "no ", ability.shows)

# %%
# The base model
# --------------
# Two hysterons. The actuator needs no starting values. The weighed mass ``m`` of ``recordings.yaml`` is an anchor
# with an error of its own. An infinite error says that these recordings do not determine a value: hysteron 1 relaxes
# too fast to be seen.

fit = phnn.identify(phnn.models.hrc(hysterons=2), campaign, phnn.Options(starts=1))
for name, (value, error) in fit.parameters.items():
    print(f"{name:6s} {value:12.4g}", "held" if error is None else f"± {error:.1g}")

# %%
# The diagnosis
# -------------
# It fits models with more and more elements, weighs them against each other, and locates the mismatch.

diagnosis = phnn.diagnose(fit)
print(diagnosis.verdict, [claim.effect.name for claim in diagnosis.claims])
print("location:", diagnosis.places[0])
for use in ("identification", "confirmation"):
    before, after = diagnosis.before.over_noise(use), diagnosis.after.over_noise(use)
    print(f"{use}: residual over noise {before:.2f} before, {after:.2f} after")

# %%
# What is left
# ------------
# The residual of the held-out recording, before and after. The seal says what was concealed.

held_out = next(r for r in campaign.recordings if r.mask("confirmation").any())
figure, axes = plt.subplots(2, 1, figsize=(9, 4), sharex=True, sharey=True, layout="constrained")
for axis, title, model in zip(axes, ("base model", "with the named effect"), (fit.model, diagnosis.model), strict=True):
    (predicted,) = (p for p in phnn.predict(model, campaign) if p.recording.name == held_out.name)
    axis.axhspan(-2e9 * held_out.noise, 2e9 * held_out.noise, color="0.9")
    axis.plot(1e3 * held_out.t, 1e9 * (held_out.y - predicted.y), linewidth=0.6)
    axis.set(ylabel="residual [nm]", title=f"{title} (grey: ± 2 standard deviations of the noise)")
axes[1].set_xlabel("time [ms]")
print("concealed:", sealed.effect, sealed.parameters)

# %%
# Keep it
# -------
# ``report.html`` tells the answer on one screen and folds the evidence below it; ``phnn.load`` loads ``model/`` again.

diagnosis.write(folder / "out")
model = phnn.load(folder / "out" / "model")
t = np.linspace(0.0, 0.1, 1001)
print(f"{1e6 * np.ptp(model.simulate(t, 60.0 * np.sin(2.0 * np.pi * 20.0 * t))):.2f} µm")
print(sorted(path.name for path in (folder / "out").iterdir() if not path.name.startswith(".")))

"""
Feed-forward control
====================

The voltage with which an actuator follows a reference, from an identified model, on a plant that the model has never
seen.

The plant has the true parameters of the generator that made the recordings; the model knows only the recordings.
"""

# %%
# A model from recordings
# -----------------------
# Four recordings of an actuator without a concealed effect.

import tempfile
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np

import phnn
from phnn.demo import generate

folder = Path(tempfile.mkdtemp())
sealed = generate(5, folder / "recordings", "none", "short")
campaign = phnn.read(folder / "recordings")
model = phnn.identify(phnn.models.hrc(hysterons=2), campaign, phnn.Options(starts=1)).model

# %%
# The reference
# -------------
# A sine of 40 Hz between 0 and 80 µm that begins at rest, sampled at 20 kHz.

t = np.arange(0.0, 0.1, 5e-5)
ramp = np.clip(t / 0.025, 0.0, 1.0)
reference = 40e-6 * (1.0 - np.cos(2.0 * np.pi * 40.0 * t)) * ramp**3 * (10.0 - 15.0 * ramp + 6.0 * ramp**2)

# %%
# The inverse
# -----------
# The motion alone says which voltage it takes; limits of the amplifier are kept, and what is missed by them is told.

found = model.inverse(t, reference, limits=(-30.0, 120.0))
print("follows:", found.follows, "| largest error of the model:", f"{1e9 * np.abs(found.error).max():.2f} nm")
print(f"voltage from {found.voltage.min():.1f} V to {found.voltage.max():.1f} V")
print(*found.messages, sep="\n")

# %%
# On the plant
# ------------
# The same two commands for the true actuator of the seal: the inverse, and the reference divided by the static gain.

true = phnn.models.hrc(2, {name: value for name, value in sealed.base.items() if name in phnn.models.hrc(2).parameters})
plant = phnn.Model(phnn.Setup(true), substeps=4)
gain = np.ptp(campaign.recordings[0].y) / np.ptp(campaign.recordings[0].u)
errors = {
    "static gain": plant.simulate(t, reference / gain) - reference,
    "inverse": plant.simulate(t, found.voltage) - reference,
}
for name, error in errors.items():
    print(f"{name:12s} {1e9 * np.sqrt(np.mean(error**2)):8.1f} nm root mean square")

figure, (left, right) = plt.subplots(1, 2, figsize=(10, 3.4), layout="constrained")
left.plot(1e3 * t, found.voltage, label="inverse")
left.plot(1e3 * t, reference / gain, label="static gain")
left.set(xlabel="time [ms]", ylabel="voltage [V]", title="command")
left.legend()
for name in ("inverse", "static gain"):
    right.semilogy(1e3 * t[1:], 1e9 * np.abs(errors[name][1:]) + 1e-3, label=name)
right.set(xlabel="time [ms]", ylabel="error on the plant [nm]", title="tracking")
_ = right.legend()

# %%
# :doc:`/feedforward` measures the inverse on sixty plants, with every effect of the catalogue, and against a linear
# inverse.

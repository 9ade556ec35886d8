"""
A sweep with hydra and joblib
=============================

Train several models on the same recordings, each in a folder of its own, and gather the table.

The same command again continues what is not finished. ``launcher=joblib`` runs as many trainings at once as the
machine has cores, here one; ``launcher=submitit`` sends them to a cluster.
"""

# %%
# Recordings
# ----------
# Simulated: two sines, a smaller sine and a step of an actuator with two hysterons.

import subprocess
import sys
import tempfile
from pathlib import Path

import matplotlib.pyplot as plt
import pandas as pd

import phnn
from phnn.demo import generate

folder = Path(tempfile.mkdtemp())
_ = generate(5, folder / "recordings", "none", "short")

# %%
# The sweep
# ---------
# Lists of values are combined: two models with one and two hysterons. Every fifth sample and three Gauss–Newton steps
# keep this page short; leave both out for a result.

script = Path(phnn.__file__).resolve().parents[1] / "scripts" / "train.py"
command = [
    sys.executable, str(script), "-m", "launcher=joblib", "hydra.launcher.n_jobs=1",
    "folder=recordings", "out=sweep", "model=hrc,neural_hrc", "model.hysterons=1,2",
    "stride=5", "gauss_newton=3", "tensorboard=false",
]  # fmt: skip
done = subprocess.run(command, cwd=folder, capture_output=True, text=True, check=False)
print(done.stdout[-1500:] or done.stderr[-1500:])

# %%
# The table
# ---------
# It lies in the folder of the sweep; ``held_out_over_noise`` is the residual of the held-out recordings over the noise.

table = pd.read_csv(folder / "sweep" / "runs.csv")
print(table[["model.kind", "model.hysterons", "state", "parameters", "held_out_over_noise"]].to_string(index=False))

figure, axis = plt.subplots(figsize=(7, 3), layout="constrained")
labels = [f"{kind}, {n}" for kind, n in zip(table["model.kind"], table["model.hysterons"], strict=True)]
axis.barh(labels, table["held_out_over_noise"].astype(float))
axis.axvline(1.0, color="0.4", linewidth=1.0)
axis.set(xlabel="held-out residual over noise", xscale="log")

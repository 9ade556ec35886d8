"""Models of hysteresis side by side: ``python scripts/rivals.py study=table [out=DIR] [compare.budget=60]``.

The studies are ``table`` and ``loops``. Public sets of the table take ``folder=DIR``, which holds a folder for each.

Writes ``STUDY.csv`` and ``STUDY.md``; ``page=FILE`` also fills the table of that study in a page of markdown.
"""

from __future__ import annotations

import os
import sys
from pathlib import Path

import hydra
from omegaconf import DictConfig, OmegaConf

from phnn.cli import ONE_THREAD

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))  # studies/ is not installed

# Budgets are those of one processor. Before numpy and torch are loaded.
os.environ.update(ONE_THREAD)


@hydra.main(version_base=None, config_path="../configs", config_name="experiment/rivals")
def main(config: DictConfig) -> None:
    """Run, and refuse bad input in one line."""
    from phnn.commands import refusals
    from studies.results import fill, filled, stamped
    from studies.rival_models.contest import run

    with refusals("rivals"):
        if config.page is not None:
            # A page without a place for the table is refused before the work.
            filled(Path(config.page), config.study, "")
        page = run(OmegaConf.to_container(config, resolve=True), lambda line: print(line, file=sys.stderr, flush=True))
        if config.page is not None:
            text = page.read_text(encoding="utf-8").split("\n", 1)[1]
            fill(Path(config.page), config.study, stamped(text))
    print(page.read_text(encoding="utf-8"))


if __name__ == "__main__":
    main()

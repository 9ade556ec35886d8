"""Studies of structures, linear or with slow springs, each made once."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from pathlib import Path

import pytest
from structure import write_folder

from phnn.modal.experiment import study_of
from phnn.modal.study import Result, Settings, study_modes
from phnn.recordings import read


@pytest.fixture(scope="session")
def studied(tmp_path_factory: pytest.TempPathFactory) -> Callable[[str, int], Result]:
    """The study of a kind of structure, by a seed."""

    @cache
    def study(kind: str, seed: int) -> Result:
        folder: Path = tmp_path_factory.mktemp(kind)
        write_folder(folder, kind, seed)
        return study_modes(study_of(read(folder)), Settings(2, 40, 2), lambda _: None)

    return study

"""The output of a run: one folder claimed for it, whole files, names that stay inside the folder."""

from phnn.output.claim import Origin, apart, claim, finished
from phnn.output.files import finite, write_atomic, write_new
from phnn.output.names import file_name, unique_names
from phnn.output.place import Place
from phnn.output.record import sha256_of
from phnn.output.sameness import same

__all__ = [
    "Origin",
    "Place",
    "apart",
    "claim",
    "file_name",
    "finished",
    "finite",
    "same",
    "sha256_of",
    "unique_names",
    "write_atomic",
    "write_new",
]

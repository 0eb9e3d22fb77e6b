"""An exported controller, compiled to a shared library and called from Python."""

from __future__ import annotations

import ctypes
import subprocess
from pathlib import Path
from typing import Any

import numpy as np

SIZES = """\
#include <stddef.h>
#include "{name}.h"
const size_t sizes[2] = {{sizeof({name}_controller), sizeof({name}_commanded)}};
"""


class ExportedController:
    """The functions of a folder that `Graph.export` wrote.

    Parameters
    ----------
    source
        The controller's C file, NAME.c.
    folder
        Where the library is written.
    compiler, words
        The C compiler, and its options.
    """

    def __init__(self, source: Path, folder: Path, compiler: str = "gcc", words: tuple[str, ...] = ("-O2",)) -> None:
        self.name = source.stem
        sizes, library = folder / "sizes.c", folder / f"{self.name}.so"
        sizes.write_text(SIZES.format(name=self.name), encoding="utf-8")
        files = [str(source), str(sizes), "-lm", "-o", str(library)]
        subprocess.run([compiler, "-std=c99", *words, "-shared", "-fPIC", f"-I{source.parent}", *files], check=True)
        self.library = ctypes.CDLL(str(library))
        size, commanded = (ctypes.c_size_t * 2).in_dll(self.library, "sizes")
        self.controller = ctypes.create_string_buffer(size)
        self.commanded = np.full(commanded // 8, np.nan)
        self.init()

    def _call(self, word: str, *given: Any) -> int:
        return int(getattr(self.library, f"{self.name}_{word}")(*given))

    def init(self) -> None:
        """Reset every state, with the parameters of the graph."""
        self._call("init", self.controller, ctypes.byref(ctypes.c_char.in_dll(self.library, f"{self.name}_defaults")))

    def reset(self, measured: np.ndarray, t: float) -> bool:
        """Initialise the states from measurements; False if they are refused."""
        return bool(self._call("reset", self.controller, _pointer(measured), ctypes.c_double(t)))

    def step(self, measured: np.ndarray, t: float) -> np.ndarray | None:
        """The commands of a sample; None if it is refused."""
        taken = self._call("step", self.controller, _pointer(measured), ctypes.c_double(t), _pointer(self.commanded))
        return self.commanded.copy() if taken else None

    def tool(self, q: np.ndarray) -> np.ndarray:
        """The tool position [m]."""
        x = np.zeros(3)
        self._call("tool", _pointer(q), _pointer(x))
        return x


def _pointer(values: np.ndarray) -> ctypes.c_void_p:
    return values.ctypes.data_as(ctypes.c_void_p)

"""WebAssembly from Python, for tests: wasmtime replaces a browser."""

from __future__ import annotations

import ctypes
from collections.abc import Callable
from ctypes.util import find_library
from typing import Any, Final

import numpy as np

from dmframe.codegen.wasm import HOST

LIBRARY: Final = ctypes.CDLL(find_library("m"))


def host(name: str) -> Callable[..., float]:
    """The C library's function, which the C code calls too."""
    function = getattr(LIBRARY, name)
    function.restype, function.argtypes = ctypes.c_double, [ctypes.c_double] * HOST[f"env.{name}"]
    return lambda *numbers: float(function(*numbers))


class Loaded:
    """A module, called with arrays: they are copied to its memory and back."""

    def __init__(self, binary: bytes) -> None:
        import wasmtime

        engine = wasmtime.Engine()
        wasmtime.Module.validate(engine, binary)
        loaded = wasmtime.Module(engine, binary)
        self.imported = {item.name for item in loaded.imports}
        self.store = wasmtime.Store(engine)
        given = [wasmtime.Func(self.store, item.type, host(item.name)) for item in loaded.imports]
        self.exports = wasmtime.Instance(self.store, loaded, given).exports(self.store)

    def __call__(self, entry: str, *given: Any) -> Any:
        memory, end = self.exports["memory"], self.exports["heap"].value(self.store)
        places, words = list[tuple[int, np.ndarray]](), list[Any]()
        for value in given:
            if isinstance(value, np.ndarray):
                places.append((end, value))
                words.append(end)
                end += value.nbytes
            else:
                words.append(value)
        memory.grow(self.store, max(0, -(-(end - memory.data_len(self.store)) // 65536)))
        for place, array in places:
            memory.write(self.store, array.tobytes(), place)
        found = self.exports[entry](self.store, *words)
        for place, array in places:
            read = memory.read(self.store, place, place + array.nbytes)
            array[...] = np.frombuffer(read, array.dtype).reshape(array.shape)
        return found

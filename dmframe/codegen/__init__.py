"""CasADi's functions in other languages: C, and WebAssembly in its binary form."""

from dmframe.codegen.source import control_source, lanes_source, loop_source
from dmframe.codegen.wasm import loop_module

__all__ = ["control_source", "lanes_source", "loop_module", "loop_source"]

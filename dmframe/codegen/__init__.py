"""Code generation from CasADi functions: C, and binary WebAssembly."""

from dmframe.codegen.source import control_source, loop_source, simd_source
from dmframe.codegen.wasm import loop_module

__all__ = ["control_source", "loop_module", "loop_source", "simd_source"]

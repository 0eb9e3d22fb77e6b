"""Text in other languages, from CasADi's functions: today C."""

from dmframe.codegen.source import control_source, loop_source

__all__ = ["control_source", "loop_source"]

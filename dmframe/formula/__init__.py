"""Laws, printed from the code that runs: read from CasADi expressions, written as text, LaTeX and Unicode."""

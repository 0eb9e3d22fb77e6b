"""Race of control laws: every law is tuned by one protocol and judged on plants and paths that it was not tuned on."""

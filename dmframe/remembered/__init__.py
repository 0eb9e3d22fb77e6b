"""Cache of the verdicts of ``dmframe verify``; an entry is valid while all of its inputs are unchanged."""

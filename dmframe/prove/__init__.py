"""A claim as data, and the checks that need no more: its identity and the faults seeded into it.

No module here depends on blocks, diagrams or CasADi. `dmframe.certify.assemble` writes a diagram's claim in this form.
"""

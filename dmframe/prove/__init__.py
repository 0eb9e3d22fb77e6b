"""A claim as data, and what is decided from that alone: its identity and the faults seeded into it.

Nothing here knows a block, a diagram or CasADi. `dmframe.certify.assemble` writes a diagram's claim in this form.
"""

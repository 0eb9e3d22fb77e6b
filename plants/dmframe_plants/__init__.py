"""Robots for dmframe, one folder each: model, defaults (`robot.toml`) and origin (`SOURCE.md`)."""

"""Design of a controller for a robot: laws tuned and compared on a family of servos, then proved and rehearsed."""

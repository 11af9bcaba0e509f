"""Simulated logs of a pivoting grasp or of three palms as their systems read them."""


def log_of(system, lines):
    """The log of these lines, the header first, without readings off the pads."""
    header, *others = lines
    rig = system.rig(header["rig"])
    events = (event for line in others for event in system.events(line["t"], line, rig))
    return system.log(rig, tuple(event for event in events if event is not None), ())

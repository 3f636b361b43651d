"""The simulated rig: physics, films, emulated instruments and the diagnosis. It never imports `rig`."""

"""Reports: HTML with figures that a person understands at a glance. Outside the loop, after the output is off."""

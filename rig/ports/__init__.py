"""Ports: opening them, carrying bytes with a deadline, simulated ones (`sim://NAME`), and pseudo-terminals.

The name of this package is in pyserial's `protocol_handler_packages` once `rig.ports.open` or
`rig.ports.registry` has been imported; `serial.serial_for_url("sim://NAME")` then opens the instrument
registered under NAME.
"""

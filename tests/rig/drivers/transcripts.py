"""Exchanges that were captured or published: the same bytes for the emulator and for the driver.

Source: Meerstetter 5117C and 5136AL (official captures), tests of the sciglob library for `set target 20.0`.
"""

from __future__ import annotations

# (what, request, reply), both without their CR
MECOM = [
    ("firmware", b"#0015AA?IF62AE", b"!0015AA8065-TEC SW G01     7199"),
    ("firmware, address 1", b"#0115AA?IF257D", b"!0115AA8065-TEC SW G01     342D"),
    ("device type", b"#0015AB?VR0064018000", b"!0015AB000004411DBD"),
    ("serial number", b"#0015AC?VR0066018125", b"!0015AC000000706F2C"),
    ("object temperature", b"#0015AB?VR03E801C21A", b"!0015AB41CD2F28D5C2"),
    ("target 21.75", b"#0015B0VS0BB80141AE0000C482", b"!0015B0C482"),
    ("output live", b"#0015AEVS07DA01000000028F97", b"!0015AE8F97"),
    ("unknown parameter", b"#0015AC?VR04D2017BFE", b"!0015AC+0532DA"),
    ("reset", b"#00BDE2RS9780", b"!00BDE29780"),
    ("target 20.0", b"#000000VS0BB80141A00000551C", b"!000000551C"),
]
OBJECT_TEMPERATURE_DEGC = 25.648026

# TE Technology: TC-36-25 RS232 manual, Appendix C p. 42 to 50, TC-48-20 manual, Appendix B p. 48 to 54; the probe and
# power on as an independent client sends them. (what, request, reply), with their ends.
TE_36_25 = [
    ("setpoint source is the computer", b"*0029000000004b\r", b"*0000000080^"),
    ("set -1.50", b"*001cffffff6aef\r", b"*ffffff6afb^"),
    ("read input 1, 2.50", b"*00010000000041\r", b"*000000fae7^"),
    ("read input 1, 10.00", b"*00010000000041\r", b"*000003e8c0^"),
    ("alarm status: high and over-current", b"*00050000000045\r", b"*0000000989^"),
    ("power on", b"*002d0000000177\r", b"*0000000181^"),
]
TE_48_20 = [("set 10.0", b"*1c00645e\r", b"*0064ca^")]
TE_BAD_SUM = {"tc-36-25": b"*XXXXXXXXc0^", "tc-48-20": b"*XXXX60^"}

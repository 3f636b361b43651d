"""The truth that the diagnosis is tested against: plate, films and instruments in full, sharing no code with `sim`.

Reading order: `hysteresis` (three kinds of film), `heat` (plate, driver, thermometer), `readings` (the ohmmeter's
side), `rig` (all together), `profiles`, `draw` (rigs from seeds), `oracle` (what a likelihood-ratio test would see),
`sizes`, `combine`, `outside`, `designs`, `controls`, `disturb`, `plans` (a case of each kind).
"""

"""One likelihood of a record: thermometer and ohmmeter together, for any effects and any form of film."""

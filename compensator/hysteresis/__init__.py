"""The film's hysteresis: parameters and memory, envelope and memoryless functions, play operators."""

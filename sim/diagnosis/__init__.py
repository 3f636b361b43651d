"""The diagnosis of a record: what its simulation gets wrong, which effects explain that, what they gain."""

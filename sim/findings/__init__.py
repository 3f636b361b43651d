"""The diagnosis: which effects a record is likely to have."""

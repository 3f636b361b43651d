"""The heat balance of the plate."""

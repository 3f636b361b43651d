"""Columns of readings, before any model: what they lack, repeat and hide, and the temperature path behind them."""

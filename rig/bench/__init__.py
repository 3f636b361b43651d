"""The bench put together: controller, meter and guard, real or simulated; the context that ends with the output off."""

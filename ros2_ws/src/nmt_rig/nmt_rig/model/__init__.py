"""Models of the plant: structures, local elements, shaker, assembly, linear modes, time integration."""

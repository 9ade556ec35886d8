"""Models of actuators with hysteresis from the literature, fitted under one budget of processor time."""

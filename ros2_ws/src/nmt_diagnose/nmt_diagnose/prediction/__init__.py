"""The rig's model as the diagnosis computes it: steady states by harmonic balance, linear responses in closed form."""

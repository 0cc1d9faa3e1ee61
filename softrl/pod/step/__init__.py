"""A step of one trajectory of the energy ROM, compiled: its polynomials, inertia, viscosity, inside, effects."""

"""From equilibria of the full model to a reduced one."""

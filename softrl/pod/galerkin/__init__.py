"""POD Galerkin with ECSW, the paper's reduction, beside the energy ROM."""

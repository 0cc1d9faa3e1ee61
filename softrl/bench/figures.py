"""Pictures of what was measured."""

from collections.abc import Sequence

from matplotlib.figure import Figure


def draw_scaling(unknowns: Sequence[int], metrics: Sequence[dict[str, float]]) -> Figure:
    """Return time and memory of the full model against the number of unknowns."""
    figure = Figure(figsize=(7.0, 3.2), layout="constrained")
    times, memory = figure.subplots(1, 2)
    for name, label in (("assembly", "assembly"), ("factor_solve", "factorisation and solution"), ("step", "time step")):
        low, middle, high = ([m[f"{name}{kind}_ms"] for m in metrics] for kind in ("_min", "", "_max"))
        spread = [[m - a for m, a in zip(middle, low, strict=True)], [b - m for m, b in zip(middle, high, strict=True)]]
        times.errorbar(unknowns, middle, yerr=spread, marker="o", capsize=3, label=label)
    times.set(xscale="log", yscale="log", xlabel="unknowns", ylabel="ms (median, shortest to longest)")
    times.legend(frameon=False)
    # the first size shares its process with the rest of the bench
    memory.plot(unknowns[1:], [m["peak_memory_gb"] for m in metrics[1:]], "o-")
    memory.set(xlabel="unknowns", ylabel="peak memory in GB", ylim=(0.0, None))
    return figure

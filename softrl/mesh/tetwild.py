"""fTetWild as a program of its own: ``python tetwild.py surface.npz tetrahedra.npz``.

The library keeps settings of its first call for all later ones and writes a file into the working directory;
in a process and a folder of its own neither matters, and a crash ends the child only.
"""

import sys

import numpy as np


def main(source: str, target: str) -> None:
    """Read surface and settings from ``source`` (lengths in mm), write points and tetrahedra to ``target``."""
    import pytetwild  # here, because it brings a whole drawing library that reading a mesh does not need

    with np.load(source, allow_pickle=False) as data:
        points, corners = pytetwild.tetrahedralize(  # type: ignore[attr-defined]
            data["points"],
            data["triangles"],
            edge_length_abs=float(data["edge"]),
            epsilon=float(data["envelope_share"]),
            stop_energy=float(data["stop_energy"]),
            num_threads=1,
        )
    np.savez(target, points=points, tetrahedra=corners)


if __name__ == "__main__":
    main(*sys.argv[1:])

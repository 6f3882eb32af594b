"""A bench file read by a command that uses it: what its drivers and its simulated bench make of it
is checked too, nothing connects.
"""

from pathlib import Path

from flflab.bench import Bench, read_bench


def described_bench(file: Path) -> Bench:
    """Read a bench file for use.

    Raises:
        InputError: a field is missing, misspelt or impossible, also one that belongs to a driver or
            to the simulated bench.
    """
    from drivers.described import require_drivable  # devices are loaded by those who use them

    bench = read_bench(file)
    require_drivable(bench)
    description = bench.description
    if "simulated" in {
        device.address
        for device in (
            *description.axes.values(),
            description.camera,
            description.iris,
            description.target,
        )
    }:
        from sim.serve import require_simulable

        require_simulable(bench)
    return bench

"""Which effects explain the runs of the fits: looked at, ranked, added, exchanged, dropped."""

"""What the recordings can carry: faults are said, repaired or refused before anything is fitted."""

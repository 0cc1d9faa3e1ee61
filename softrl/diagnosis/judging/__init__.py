"""What held-out runs say: what is named, what does as well, what is left, what competes."""

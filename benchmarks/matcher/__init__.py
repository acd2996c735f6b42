"""`slam bench matcher`: speed, accuracy, basin and consistency of single matches."""

"""`slam bench matcher`: speed, accuracy, basin and honesty of single matches."""

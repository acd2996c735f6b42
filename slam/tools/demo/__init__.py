"""`slam demo`: a simulated robot in the test bed of the paper, or a real building."""

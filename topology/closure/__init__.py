"""Loop closure: which passes of one run were by the same place, with the evidence for it."""

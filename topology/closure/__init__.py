"""Loop closure: which passes of one run were by the same place, and how sure that is."""

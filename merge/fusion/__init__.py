"""Maps and accepted verdicts to one fused map (§4)."""

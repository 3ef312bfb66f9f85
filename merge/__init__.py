"""Maps of many runs to pair verdicts, clusters and fused maps. Imports only `topology`."""

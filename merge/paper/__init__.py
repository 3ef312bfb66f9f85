"""The method of Huang & Beevers, *Topological Map Merging*, as published."""

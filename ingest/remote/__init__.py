"""Logs in buckets and on web servers: addresses, listings, and byte ranges instead of files."""

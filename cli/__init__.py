"""The `topobatch` command: parse, call, show. The only place that prints or exits."""

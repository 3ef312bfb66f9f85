"""Log files to runs (odometry, junction passes) and to maps. Imports only `topology`."""

"""`topobatch simulate`: logs of made-up robots, with the truth beside them."""

"""What is known of a robot before anything is measured: bounds, nominal links, published values."""

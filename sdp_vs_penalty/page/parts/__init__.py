"""What the five stages of the page are made of, one file a part: from a robot to a model in use."""

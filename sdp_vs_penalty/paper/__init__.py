"""What belongs to the paper alone: its tables and figures made again."""

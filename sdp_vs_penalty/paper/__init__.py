"""What results/ holds, made again: the paper's tables and figures, and the solvers'
shootout."""

import cProfile
import pstats

from sdp_vs_penalty.data import load_measurements

load_measurements("/tmp/intake/plain.csv")
pr = cProfile.Profile()
pr.enable()
load_measurements("/tmp/intake/plain.csv")
pr.disable()
pstats.Stats(pr).sort_stats("tottime").print_stats(16)

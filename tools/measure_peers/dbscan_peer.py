"""Times DBSCAN of scikit-learn, for measure_peers.py; a process of its own, whose memory is its own.

    dbscan_peer.py POINTS.npy RADIUS MIN_SAMPLES THREADS OUT.npz

Prints the seconds of fit(). OUT.npz has `labels` and `core`, by number of the point.
"""

import sys
import time

import numpy as np
from sklearn.cluster import DBSCAN

points = np.load(sys.argv[1]).astype(np.float64)
begin = time.perf_counter()
fitted = DBSCAN(eps=float(sys.argv[2]), min_samples=int(sys.argv[3]), n_jobs=int(sys.argv[4])).fit(points)
print(time.perf_counter() - begin)
core = np.zeros(len(points), bool)
core[fitted.core_sample_indices_] = True
np.savez(sys.argv[5], labels=fitted.labels_, core=core)

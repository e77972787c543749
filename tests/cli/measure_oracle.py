"""Measures of small scenes in NumPy's doubles, over all pairs, from the formulas in docs/measures.md; who is a neighbor and who is
nearest is settled in fractions where doubles come close."""
from fractions import Fraction

import numpy as np

PCA = {"anisotropy": 0.25, "stretch": 1.0, "threshold": 20, "average": 1.0}


def weight(kernel, distances, support):
    """W(d), whose integral over space is 1."""
    q = np.minimum(distances / support, 1)
    if kernel == "cubic":
        return 8 / (np.pi * support**3) * np.where(q < 0.5, 1 - 6 * q**2 + 6 * q**3, 2 * (1 - q)**3)
    if kernel == "wendland2":
        return 21 / (2 * np.pi * support**3) * (1 - q)**4 * (1 + 4 * q)
    if kernel == "poly6":
        return 315 / (64 * np.pi * support**3) * (1 - q**2)**3
    assert kernel == "tophat"
    return 3 / (4 * np.pi * support**3) * np.ones_like(q)


def squared(a, b):
    return sum((Fraction(x) - Fraction(y))**2 for x, y in zip(a.tolist(), b.tolist()))


def good(radii):
    return np.where(np.isfinite(radii) & (radii > 0), radii, -np.inf)


def reach_of(shape, radius=None, query_radii=None, point_radii=None, mode="gather"):
    """The radius of each pair; -inf reaches nobody."""
    if radius is not None:
        return np.full(shape, float(radius))
    reach = np.full(shape, -np.inf)
    if mode != "scatter":
        reach = np.maximum(reach, good(query_radii)[:, None])
    if mode != "gather":
        reach = np.maximum(reach, good(point_radii)[None])
    return reach


class Scene:
    """Who is whose neighbor, and what there is to sum."""

    def __init__(self, points, queries=None, nearest=0, asks=None, candidates=None, **radii):
        self.points = np.asarray(points, np.float64).reshape(-1, 3)
        self.one_set = queries is None
        self.queries = self.points if self.one_set else np.asarray(queries, np.float64)
        shape = len(self.queries), len(self.points)
        self.reach = reach_of(shape, **radii)
        self.finite = np.isfinite(self.queries).all(1)
        self.asks = self.finite & (np.ones(shape[0], bool) if asks is None else asks)
        self.chosen = np.isfinite(self.points).all(1) & (np.ones(shape[1], bool) if candidates is None else candidates)
        with np.errstate(invalid="ignore"):
            self.differences = self.points[None] - self.queries[:, None]
            self.distances = np.sqrt((self.differences**2).sum(2))
            self.near = self.distances <= self.reach
            border = np.isfinite(self.reach) & (np.abs(self.distances - self.reach) <= 1e-9 * self.reach)
        for i, j in np.argwhere(border & self.asks[:, None] & self.chosen[None]):
            self.near[i, j] = squared(self.points[j], self.queries[i]) <= Fraction(self.reach[i, j])**2
        self.near &= self.asks[:, None] & self.chosen[None]
        if self.one_set:
            np.fill_diagonal(self.near, False)
        if nearest:
            for i in range(shape[0]):
                self.near[i, self.by_distance(i)[nearest:]] = False
        # Those of the sums that the query itself belongs to.
        self.summed = self.near.copy()
        if self.one_set:
            np.fill_diagonal(self.summed, self.asks & self.chosen & (np.diag(self.reach) > 0))

    def by_distance(self, i):
        row = np.flatnonzero(self.near[i])
        return sorted(row, key=lambda j: (squared(self.points[j], self.queries[i]), j))

    def over(self, which, values):
        return np.where(which, values, 0.0)

    def offsets(self, which):
        """x_j - x_i, 0 where there is no pair."""
        return np.where(which[..., None], self.differences, 0.0)

    def weights(self, kernel, which):
        with np.errstate(invalid="ignore", divide="ignore"):
            return self.over(which, weight(kernel, self.distances, self.reach))


def ratio(sums, weights):
    with np.errstate(invalid="ignore", divide="ignore"):
        return np.where(weights > 0, sums / weights, 0.0)


def covariance(scene, weights):
    """Mean offset from the query and covariance, by the weights of the points that are summed."""
    offsets, total = scene.offsets(scene.summed), weights.sum(1)
    mean = ratio(np.einsum("ij,ijk->ik", weights, offsets), total[:, None])
    about = np.where(scene.summed[..., None], offsets - mean[:, None], 0.0)
    matrix = np.einsum("ij,ijk,ijl->ikl", weights, about, about)
    return mean, ratio(matrix, total[:, None, None])


def components(near):
    """A label for each point: the smallest number that pairs lead to, whichever way they go."""
    import scipy.sparse
    import scipy.sparse.csgraph
    count, labels = scipy.sparse.csgraph.connected_components(scipy.sparse.csr_matrix(near), directed=True, connection="weak")
    smallest = np.full(count, len(labels))
    np.minimum.at(smallest, labels, np.arange(len(labels)))
    return smallest[labels]


def rank(labels):
    """0, 1, 2, ... in the order of the labels; -1 stays."""
    known = np.unique(labels[labels >= 0])
    return np.where(labels < 0, -1, np.searchsorted(known, labels))


def dbscan(near, finite, min_neighbors):
    """Cores are connected; any other point goes with the core of the smallest number that is its neighbor, or has it as one."""
    core = near.sum(1) >= min_neighbors
    either = near | near.T
    labels = np.full(len(near), -1)
    for start in np.flatnonzero(core):
        waiting = [start] if labels[start] < 0 else []
        while waiting:
            point = waiting.pop()
            labels[point] = start
            waiting += [other for other in np.flatnonzero(either[point] & core) if labels[other] < 0]
    cores = labels.copy()
    for point in np.flatnonzero(~core & finite):
        reached = np.flatnonzero(either[point] & core)
        labels[point] = cores[reached[0]] if len(reached) else -1
    return rank(labels)


def cluster(scene, min_neighbors=None):
    if min_neighbors:
        labels = dbscan(scene.near, scene.finite, min_neighbors)
    else:
        labels = rank(np.where(scene.finite, components(scene.near), -1))
    sizes = np.bincount(labels[labels >= 0], minlength=1)
    return labels, np.where(labels >= 0, sizes[np.maximum(labels, 0)], 0)


def average(scene, weights, values):
    """The average, and the largest magnitude among what it is made of."""
    width = values.reshape(len(values), -1).astype(np.float64)
    valid = np.isfinite(width).all(1)
    clean = np.where(valid[:, None], width, 0.0)
    used = weights * valid[None]
    mean = ratio(used @ clean, used.sum(1)[:, None])
    scale = np.max(np.where(scene.summed & valid[None], np.abs(clean).max(1)[None], 0.0), axis=1, initial=0)
    return mean.reshape(-1, *values.shape[1:]), scale


def pca(scene, options):
    """mean, covariance, stretch, ellipsoids"""
    with np.errstate(invalid="ignore", divide="ignore"):
        weights = scene.over(scene.summed, 1 - np.minimum(scene.distances / scene.reach, 1)**3)
    mean, matrix = covariance(scene, weights)
    members = scene.summed.sum(1)
    ellipsoids = (members >= options["threshold"]) & (options["threshold"] > 0)
    lengths = np.linalg.eigvalsh(matrix)[:, ::-1]
    stretch = np.full((len(members), 3), options["stretch"])
    for i in np.flatnonzero(ellipsoids):
        raised = np.maximum(lengths[i], options["anisotropy"] * lengths[i, 0])
        stretch[i] = raised / np.cbrt(raised.prod()) if lengths[i, 0] > 0 else 1
    return mean, matrix, stretch, ellipsoids

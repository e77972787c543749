"""What the tests of measures share: points with values of every kind, and the comparison of what search writes with NumPy's sums."""
import numpy as np

import measure_oracle
from cli_case import CliCase

KERNELS = ("cubic", "wendland2", "poly6", "tophat")
SCALARS = ["count", "density", "mean_distance", "nearest_distance", "nearest", "normal", "eigenvalues", "pca"]
CLUSTERS = ["cluster", "cluster_size"]
GROUPS = ["isolated", "nonfinite"]
TYPES = {"count": "<i4", "density": "<f4", "mean_distance": "<f4", "nearest_distance": "<f4", "nearest": "<i4",
         "normal": "<f4", "eigenvalues": "<f4", "stretch": "<f4", "xform": "<f4", "pws": "<f8", "cluster": "<i4",
         "cluster_size": "<i4", "isolated": "|b1", "nonfinite": "|b1", "ellipsoids": "|b1"}
HALF_ULP = 2.0**-24


def values_of(count, seed=4):
    """Values of every kind that an average takes, and masses; some are not finite."""
    rng = np.random.default_rng(seed)
    values = {"heat": rng.normal(size=count).astype(np.float32), "work": rng.normal(size=count) * 1e3,
              "v": rng.normal(size=(count, 3)).astype(np.float32), "vd": rng.normal(size=(count, 3)),
              "kind": rng.integers(-9, 9, count).astype(np.int32), "big": rng.integers(-2**40, 2**40, count),
              "mass": rng.random(count), "fluid": rng.random(count) < 0.6, "wall": rng.random(count) < 0.2}
    for k, (name, bad) in enumerate((("heat", np.nan), ("work", np.inf), ("v", -np.inf), ("vd", np.nan))):
        values[name][k::7] = bad
        if values[name].ndim == 2:
            values[name][k::7, 1:] = 5  # one number that is none is enough
    return values


AVERAGED = ["heat", "work", "v", "vd", "kind", "big"]


def lattice(edge, spacing):
    return np.stack(np.meshgrid(*[np.arange(edge)] * 3, indexing="ij"), -1).reshape(-1, 3) * spacing


class MeasureCase(CliCase):
    def npz(self, name, positions, values=None):
        np.savez(self.path(name), positions=positions, **(values or {}))
        return self.path(name)

    def measured(self, input, names, *args):
        """The arrays by their bare names, and the report."""
        out = self.path("measured.npz")
        report = self.report("search", input, "--attributes", ",".join(names), "--attributes-output", out, "-f", *args)
        with np.load(out) as file:
            return {name[4:] if name.startswith("nns_") else name: file[name] for name in file.files}, report

    def near(self, name, got, expected, atol):
        """Within the rounding of the type and `atol`, a number for each point."""
        got, rounding = got.astype(np.float64), 2 * HALF_ULP if got.dtype == np.float32 else 1e-13
        allowed = rounding * np.abs(expected) + np.reshape(atol, (-1,) + (1,) * (expected.ndim - 1))
        bad = np.argwhere(~(np.abs(got - expected) <= allowed))
        if len(bad):
            place = tuple(bad[0])
            self.fail(f"{name}{list(place)}: {got[place]!r} instead of {expected[place]!r}, {len(bad)} differ")

    def agrees(self, found, scene, kernel="cubic", mass=1.0, values=None, min_neighbors=None, pca=None):
        values = values or {}
        options = dict(measure_oracle.PCA, **(pca or {}))
        rows = len(scene.queries)
        for name, array in found.items():
            self.assertEqual(len(array), rows, name)
            self.assertEqual(array.dtype.str, TYPES.get(name, array.dtype.str), name)
            if array.dtype.kind == "f" and name != "pws":
                self.assertTrue(np.isfinite(array).all(), name)
        counts = scene.near.sum(1)
        support = np.max(scene.reach, axis=1, where=scene.summed, initial=0)
        tiny = 1e-12 * np.ones(rows)
        weights = scene.weights(kernel, scene.summed)
        distances = scene.over(scene.near, scene.distances)
        for name, got in found.items():
            if name == "count":
                np.testing.assert_array_equal(got, counts)
            elif name == "density":
                masses = np.broadcast_to(np.float64(mass), len(scene.points))
                self.near(name, got, weights @ masses, tiny * weights.max(1, initial=0) * masses.max(initial=0))
            elif name == "mean_distance":
                self.near(name, got, np.where(counts > 0, distances.sum(1) / np.maximum(counts, 1), -1), 0)
            elif name == "nearest":
                first = [row[0] if row else -1 for row in map(scene.by_distance, range(rows))]
                np.testing.assert_array_equal(got, first)
            elif name == "nearest_distance":
                least = np.min(np.where(scene.near, scene.distances, np.inf), axis=1, initial=np.inf)
                self.near(name, got, np.where(counts > 0, least, -1), 0)
            elif name.startswith("average:"):
                array = values[name[8:]]
                kind = {"i": np.dtype("<f4")}.get(array.dtype.kind, array.dtype)
                self.assertEqual((got.dtype, got.shape[1:]), (kind, array.shape[1:]), name)
                mean, scale = measure_oracle.average(scene, weights, array)
                self.near(name, got, mean, 2e-13 * scale)
            elif name == "normal":
                self.normals(got, scene, weights)
            elif name == "eigenvalues":
                _, matrix = measure_oracle.covariance(scene, weights)
                self.near(name, got, np.linalg.eigvalsh(matrix)[:, ::-1], 1e-12 * support**2)
            elif name == "isolated":
                np.testing.assert_array_equal(got, scene.asks & (counts == 0))
            elif name == "nonfinite":
                np.testing.assert_array_equal(got, ~scene.finite)
        if "stretch" in found:
            self.ellipsoids(found, scene, support, options)
        if "cluster" in found:
            labels, sizes = measure_oracle.cluster(scene, min_neighbors)
            np.testing.assert_array_equal(found["cluster"], labels)
            np.testing.assert_array_equal(found["cluster_size"], sizes)

    def normals(self, got, scene, weights):
        offsets = scene.offsets(scene.near)
        sums = -np.einsum("ij,ijk->ik", weights, offsets)
        lengths = np.linalg.norm(sums, axis=1)
        terms = (weights * scene.over(scene.near, scene.distances)).sum(1)
        clear = lengths > 1e-9 * terms
        self.near("normal", got[clear], sums[clear] / lengths[clear, None], 1e-12 * terms[clear] / lengths[clear])
        self.assertTrue((got[terms == 0] == 0).all())
        lengths = np.linalg.norm(got.astype(np.float64), axis=1)
        self.assertTrue(((np.abs(lengths - 1) < 1e-6) | (lengths == 0)).all())

    def ellipsoids(self, found, scene, support, options):
        mean, matrix, stretch, ellipsoids = measure_oracle.pca(scene, options)
        np.testing.assert_array_equal(found["ellipsoids"], ellipsoids)
        moved = np.where(scene.summed.any(1)[:, None], scene.queries + options["average"] * mean, scene.queries)
        finite = np.isfinite(scene.queries)
        self.near("pws", found["pws"][scene.finite], moved[scene.finite],
                  1e-12 * support[scene.finite] + 1e-15 * np.abs(scene.queries[scene.finite]).max(1, initial=0))
        np.testing.assert_array_equal(np.isfinite(found["pws"]), finite)
        axes = found["xform"].astype(np.float64)
        np.testing.assert_array_equal(axes[~ellipsoids], np.broadcast_to(np.eye(3), axes[~ellipsoids].shape))
        np.testing.assert_allclose(np.einsum("iab,iac->ibc", axes, axes), np.broadcast_to(np.eye(3), axes.shape), atol=4e-7)
        self.assertTrue((np.linalg.det(axes) > 0.99).all())
        lengths = np.linalg.eigvalsh(matrix)[:, ::-1]
        # Relative to each point's largest length: below that stretch is made of rounding.
        clear = ellipsoids & (lengths[:, 0] > 1e-12 * support**2)
        self.near("stretch", found["stretch"][clear | ~ellipsoids], stretch[clear | ~ellipsoids], 3e-7)
        rebuilt = np.einsum("iab,ib,icb->iac", axes, lengths, axes)
        self.near("xform", rebuilt[clear].reshape(-1, 9), matrix[clear].reshape(-1, 9), 6e-7 * lengths[clear, 0])
        for k in (0, 1):
            column = axes[clear, :, k]
            if len(column):
                order = np.sort(np.abs(column), axis=1)
                apart = order[:, 2] - order[:, 1] > 1e-6
                largest = np.take_along_axis(column, np.abs(column).argmax(1)[:, None], 1)[:, 0]
                self.assertTrue((largest[apart] > 0).all())

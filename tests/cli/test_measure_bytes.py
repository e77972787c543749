"""What must not change a byte of any measure, and what changes measures in a known way."""
import numpy as np

from measure_case import AVERAGED, CLUSTERS, GROUPS, SCALARS, MeasureCase, values_of


class Unchanged(MeasureCase):
    names = SCALARS + CLUSTERS + GROUPS + ["average:" + name for name in AVERAGED]

    def dyadic(self, count=900):
        """Points whose coordinates, sums and differences are floats."""
        return np.random.default_rng(13).integers(0, 4096, (count, 3)).astype(np.float32) / 1024

    def same(self, found, expected, but=()):
        self.assertEqual(sorted(found), sorted(expected))
        for name in found:
            if name not in but:
                self.assertEqual((found[name].dtype, found[name].shape), (expected[name].dtype, expected[name].shape), name)
                self.assertEqual(found[name].tobytes(), expected[name].tobytes(), name)

    def test_ways_to_search(self):
        points = self.dyadic(2500)
        points[5::90] = np.nan
        input = self.npz("in.npz", points, values_of(len(points)))
        np.save(self.path("radii.npy"), np.random.default_rng(1).uniform(0.05, 0.5, len(points)))
        uniform, own = ["-r", 0.4], ["--radius-file", self.path("radii.npy"), "--radius-mode", "symmetric"]
        fixed = ["--mass-attribute", "mass", "--pca-threshold", 9]
        for args in (uniform, own, [*uniform, "--min-neighbors", 12]):
            first = None
            ways = [["-T", threads] for threads in (1, 2, 8)] + [["--cell-size", size] for size in (0.5, 1, 2, "auto")]
            ways += [["--encoding", encoding] for encoding in ("index", "mask", "none")] + [["--checksum"], ["--host-memory", "150MiB"]]
            ways += [[*more, "-o", self.path("lists.npz")] for more in ([], ["--encoding", "index"], ["--encoding", "mask"],
                                                                        ["--lists", "distance", "--order", "distance"])]
            ways += [["--repeat", 2], ["-o", self.path("points.ply"), "-o", self.path("points.vdb")]]
            if args is not own:
                ways += [["--device", "sim", "--device-memory", memory] for memory in ("1MiB", "64MiB")]
                ways += [["--device", "sim", "--device-memory", "1MiB", "-o", self.path("lists.npz"), "--encoding", "index"]]
            for way in ways:
                with self.subTest(args=args, way=way):
                    self.measured(input, self.names, *args, *fixed, *way)
                    first = first or self.bytes(self.path("measured.npz"))
                    self.assertEqual(self.bytes(self.path("measured.npz")), first)
        found, _ = self.measured(input, self.names, *uniform, *fixed)
        for name in self.names[:8]:
            if name != "pca":
                alone, _ = self.measured(input, [name], *uniform, *fixed[:2 if name == "density" else 0])
                self.assertEqual(alone[name].tobytes(), found[name].tobytes(), name)

    def test_budgets_of_a_device(self):
        path = self.scene("clusters", 30000)
        names = [*SCALARS, *CLUSTERS, *GROUPS]
        self.measured(path, names)
        expected = self.bytes(self.path("measured.npz"))
        for way in (["--device-memory", "1MiB"], ["--device-memory", "4MiB", "--boundary", "halo"], ["--boundary", "cpu"]):
            _, report = self.measured(path, names, "--device", "sim", *way, "-o", self.path("lists.npz"))
            self.assertEqual(report["device"]["kind"], "sim")
            self.assertEqual(self.bytes(self.path("measured.npz")), expected, way)
        self.measured(path, names, "--host-memory", "200MiB", "-T", 1)
        self.assertEqual(self.bytes(self.path("measured.npz")), expected)

    def test_order_of_points(self):
        points, values = self.dyadic(), values_of(900)
        order = np.random.default_rng(3).permutation(900)
        before, _ = self.measured(self.npz("a.npz", points, values), self.names, "-r", 0.4, "--mass-attribute", "mass")
        after, _ = self.measured(self.npz("b.npz", points[order], {n: v[order] for n, v in values.items()}), self.names, "-r", 0.4,
                                 "--mass-attribute", "mass")
        self.same(after, {name: array[order] for name, array in before.items()}, but=["nearest", "cluster"])
        pairs = np.unique(np.stack([after["cluster"], before["cluster"][order]], 1), axis=0)
        self.assertEqual(len(pairs), after["cluster"].max() + 1)

    def moved(self, points, values, name, shift=0, voxel=0.25):
        """The measures of a grid that is moved by whole voxels, and its numbers in the order of `points`."""
        source = self.npz(name + ".npz", points + np.float32(voxel) * np.asarray(shift, np.float32), values)
        grid = self.path(name + ".vdb")
        report = self.report("convert", source, "-o", grid, "--voxel-size", voxel)
        self.assertEqual(report["output"]["largest_rounding"], 0)
        self.succeeds("convert", grid, "-o", self.path(name + "_back.npz"), "-q")
        found, _ = self.measured(grid, self.names, "-r", 0.4, "--mass-attribute", "mass")
        return found, np.argsort(np.load(self.path(name + "_back.npz"))["id"])

    def test_moved_grids(self):
        points, values = self.dyadic(), values_of(900)
        here, numbers = self.moved(points, values, "here")
        for k, shift in enumerate(([4096, 0, -8192], [4096 * 7, 4096, 4096])):
            there, others = self.moved(points, values, f"far{k}", shift)
            np.testing.assert_array_equal(numbers, others)
            self.same(there, here, but=["pws"])
            np.testing.assert_allclose(there["pws"], here["pws"] + 0.25 * np.array(shift), rtol=1e-14)
        # Other leaves, and so other numbers.
        for k, shift in enumerate(([1, 2, 3], [-5, 100, -4099])):
            there, others = self.moved(points, values, f"near{k}", shift)
            self.same({n: a[others] for n, a in there.items()}, {n: a[numbers] for n, a in here.items()},
                      but=["pws", "nearest", "cluster"])
        # Voxels whose edge is no sum of powers of two.
        for offset in (0, 4096):
            self.succeeds("scene", "far", "-n", 1500, "--offset", offset, "-o", self.path(f"{offset}.vdb"), "-q")
            self.succeeds("convert", self.path(f"{offset}.vdb"), "-o", self.path(f"{offset}.npz"), "-q")
        apart = np.load(self.path("4096.npz"))["positions"] - np.load(self.path("0.npz"))["positions"]
        self.assertLess(np.ptp(apart, axis=0).max(), 1e-12)  # the same voxels, the same P
        here, there = (self.measured(self.path(f"{offset}.vdb"), SCALARS + CLUSTERS + GROUPS)[0] for offset in (0, 4096))
        self.same(there, here, but=["pws"])

    def test_scaled_scenes(self):
        points, values = np.random.default_rng(17).normal(size=(700, 3)), values_of(700)
        before, _ = self.measured(self.npz("a.npz", points, values), self.names, "-r", 0.5, "--mass-attribute", "mass")
        for factor in (2.0, 0.25, 2.0**20):
            after, _ = self.measured(self.npz("b.npz", points * factor, values), self.names, "-r", 0.5 * factor,
                                     "--mass-attribute", "mass")
            powers = {"density": -3, "mean_distance": 1, "nearest_distance": 1, "pws": 1, "eigenvalues": 2}
            expected = {}
            for name, array in before.items():
                expected[name] = array * array.dtype.type(factor**powers[name]) if name in powers else array
                if name.endswith("distance"):
                    expected[name] = np.where(array == -1, array, expected[name])
            self.same(after, expected)

    def test_turned_scenes(self):
        points, values = self.dyadic(), values_of(900)
        turn = np.array([[0, -1, 0], [1, 0, 0], [0, 0, 1]])
        fixed = ["--mass-attribute", "mass", "--pca-threshold", 5]
        before, _ = self.measured(self.npz("a.npz", points, values), self.names, "-r", 0.5, *fixed)
        after, _ = self.measured(self.npz("b.npz", points @ turn.T.astype(np.float32), values), self.names, "-r", 0.5,
                                 *fixed)
        turned = {"normal", "xform", "pws"}
        # Distances and sums of scalars are exact here or rounded alike; those of three terms are added in another order.
        self.same(after, before, but=[*turned, "eigenvalues", "stretch"])
        np.testing.assert_allclose(after["normal"], before["normal"] @ turn.T, atol=2e-7)
        np.testing.assert_allclose(after["pws"], before["pws"] @ turn.T, atol=1e-12)
        for name in ("eigenvalues", "stretch"):
            np.testing.assert_allclose(after[name], before[name], rtol=3e-7, atol=1e-15)
        stretch = before["stretch"]
        apart = before["ellipsoids"] & (stretch[:, 0] > 1.01 * stretch[:, 1]) & (stretch[:, 1] > 1.01 * stretch[:, 2])
        self.assertGreater(apart.sum(), 100)
        expected = turn @ before["xform"][apart]
        signs = np.sign((expected * after["xform"][apart]).sum(1, keepdims=True))
        np.testing.assert_allclose(after["xform"][apart], expected * signs, atol=1e-5)

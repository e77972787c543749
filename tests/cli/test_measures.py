"""Measures of every distribution, kernel, set of queries and radius: what search --attributes writes against NumPy."""
import numpy as np

import measure_oracle
from measure_case import AVERAGED, CLUSTERS, GROUPS, KERNELS, SCALARS, MeasureCase, lattice, values_of
from measure_oracle import Scene
from test_convert import read_ply


def scenes():
    """Name, positions, radius."""
    rng = np.random.default_rng(11)
    uniform = rng.random((400, 3))
    sheet = uniform * [1, 1, 0]
    broken = uniform.copy()
    broken[5::41, 0], broken[9::53, 2], broken[77] = np.nan, np.inf, -np.inf
    yield "uniform", uniform, 0.2
    yield "uniform_float", uniform.astype(np.float32), 0.25
    yield "lattice_at_the_radius", lattice(6, 0.125), 0.25
    yield "lattice_that_rounds", lattice(6, 0.1), 0.2
    yield "coincident", np.concatenate([np.full((70, 3), 0.3), np.full((2, 3), 0.35), uniform[:30] + 4]), 0.1
    yield "one", uniform[:1], 0.5
    yield "two", np.array([[0, 0, 0], [0.25, 0.5, 0]]), 0.75
    yield "none_within_reach", lattice(4, 1.0), 0.5
    yield "sheet", sheet, 0.1
    yield "tilted_sheet", sheet @ np.linalg.qr(rng.normal(size=(3, 3)))[0], 0.1
    yield "line", uniform[:200, :1] * [1, 2, -1], 0.1
    yield "far", uniform + 1e6, 0.2
    yield "negative", -3 * uniform - 1, 0.5
    yield "broken", broken, 0.2
    yield "all_broken", np.full((3, 3), np.nan), 0.2


class OfAllPairs(MeasureCase):
    def test_every_distribution_and_kernel(self):
        names = SCALARS + CLUSTERS + GROUPS + ["average:" + name for name in AVERAGED]
        for scene_name, positions, radius in scenes():
            values = values_of(len(positions))
            input = self.npz("in.npz", positions, values)
            scene = Scene(positions, radius=radius)
            for kernel in KERNELS:
                with self.subTest(scene=scene_name, kernel=kernel):
                    found, report = self.measured(input, names, "-r", radius, "--kernel", kernel, "--mass-attribute", "mass",
                                                  "--pca-threshold", 6)
                    self.agrees(found, scene, kernel, values["mass"], values, pca={"threshold": 6})
                    skipped = {n: int((~np.isfinite(values[n].reshape(len(positions), -1)).all(1)).sum()) for n in AVERAGED}
                    self.assertEqual(report["measures"]["skipped_values"], {n: k for n, k in skipped.items() if k})

    def test_symmetric_sums_are_zero(self):
        """The middle of an exact lattice has no normal: its terms cancel to the bit."""
        points = lattice(7, 0.125)
        for kernel in KERNELS:
            found, _ = self.measured(self.npy("in.npy", points), ["normal", "eigenvalues"], "-r", 0.25, "--kernel", kernel)
            inner = ((points > 0.2) & (points < 0.55)).all(1)
            self.assertEqual(inner.sum(), 27)
            np.testing.assert_array_equal(found["normal"][inner], 0)
            outer = ((points == 0) | (points == 0.75)).any(1)
            self.assertTrue((np.linalg.norm(found["normal"][outer], axis=1) > 0.99).all())
            np.testing.assert_array_equal(found["eigenvalues"][inner][:, 0], found["eigenvalues"][inner][:, 2])

    def test_masses(self):
        points = np.random.default_rng(2).random((300, 3))
        values = dict(values_of(300), grams=np.arange(300, dtype=np.int32), nothing=np.zeros(300, np.float32))
        input = self.npz("in.npz", points, values)
        scene = Scene(points, radius=0.2)
        for args, mass in (([], 1), (["--mass", 2.5], 2.5), (["--mass", 0], 0), (["--mass", 1e-9], 1e-9), (["--mass", 1e12], 1e12),
                           (["--mass-attribute", "mass"], values["mass"]), (["--mass-attribute", "grams"], values["grams"]),
                           (["--mass-attribute", "nothing"], values["nothing"])):
            with self.subTest(args):
                found, _ = self.measured(input, ["density"], "-r", 0.2, *args)
                self.agrees(found, scene, mass=mass)

    def test_options_of_pca(self):
        points = np.random.default_rng(2).random((500, 3)) * [1, 1, 0.05]
        input, scene = self.npy("in.npy", points, np.float64), Scene(points, radius=0.12)
        for options in ({}, {"anisotropy": 1.0}, {"anisotropy": 0.01}, {"stretch": 2.5}, {"stretch": -0.5}, {"threshold": 1},
                        {"threshold": 0}, {"threshold": 4000000000}, {"average": 0.0}, {"average": 0.3},
                        {"anisotropy": 0.5, "stretch": 3.0, "threshold": 12, "average": 0.75}):
            with self.subTest(options):
                flags = [word for name, value in options.items() for word in ("--pca-" + name, value)]
                found, _ = self.measured(input, ["pca"], "-r", 0.12, *flags)
                self.agrees(found, scene, pca=options)

    def test_dbscan(self):
        rng = np.random.default_rng(8)
        centres = rng.random((12, 3))
        blobs = (centres[rng.integers(0, 12, 700)] + rng.normal(size=(700, 3)) * 0.03)
        broken = blobs.copy()
        broken[3::50] = np.nan
        for name, points, radius in (("blobs", blobs, 0.04), ("broken", broken, 0.05), ("lattice", lattice(6, 0.125), 0.125),
                                     ("coincident", np.concatenate([np.zeros((40, 3)), blobs[:30]]), 0.03)):
            scene = Scene(points, radius=radius)
            input = self.npy("in.npy", points, np.float64)
            for least in (1, 2, 4, 5, 6, 12, 39, 1000):
                with self.subTest(name, least=least):
                    found, _ = self.measured(input, CLUSTERS, "-r", radius, "--min-neighbors", least)
                    self.agrees(found, scene, min_neighbors=least)
        # A point within reach of two clusters goes with that of the smaller core number.
        ends = np.array([[k, 0, 0] for k in (10, 11, 12, 13, 1, 2, 3, 4, 7)])
        found, _ = self.measured(self.npy("ends.npy", ends), CLUSTERS, "-r", 3, "--min-neighbors", 3)
        self.assertEqual(found["cluster"].tolist(), [0, 0, 0, 0, 1, 1, 1, 1, 0])
        self.assertEqual(found["cluster_size"].tolist(), [5, 5, 5, 5, 4, 4, 4, 4, 5])

    def test_a_larger_scene(self):
        """20 000 points by a tree's pairs."""
        import scipy.sparse
        import scipy.spatial
        count, radius = 20000, 0.07
        points = np.random.default_rng(6).random((count, 3)).astype(np.float32)
        values = values_of(count)
        found, report = self.measured(self.npz("in.npz", points, values),
                                      ["count", "density", "mean_distance", "nearest_distance", "average:work", "normal", *CLUSTERS],
                                      "-r", radius, "--mass-attribute", "mass")
        exact = points.astype(np.float64)
        i, j = scipy.spatial.cKDTree(exact).query_pairs(radius, output_type="ndarray").T
        i, j = np.concatenate([i, j]), np.concatenate([j, i])
        d = np.linalg.norm(exact[j] - exact[i], axis=1)
        w, own = measure_oracle.weight("cubic", d, radius), measure_oracle.weight("cubic", np.zeros(count), radius)

        def total(terms):
            return np.bincount(i, terms, count)
        self.assertEqual(report["result"]["pairs"], len(i))
        counts = np.bincount(i, minlength=count)
        np.testing.assert_array_equal(found["count"], counts)
        self.near("density", found["density"], total(w * values["mass"][j]) + own * values["mass"], 0)
        self.near("mean_distance", found["mean_distance"], np.where(counts, total(d) / np.maximum(counts, 1), -1), 0)
        least = np.full(count, np.inf)
        np.minimum.at(least, i, d)
        self.near("nearest_distance", found["nearest_distance"], np.where(counts, least, -1), 0)
        valid = np.isfinite(values["work"])
        work = np.where(valid, values["work"], 0)
        mean = measure_oracle.ratio(total(w * work[j]) + own * work, total(w * valid[j]) + own * valid)
        self.near("average:work", found["average:work"], mean, 1e-9)
        sums = np.stack([total(w * (exact[i] - exact[j])[:, k]) for k in range(3)], 1)
        lengths = np.linalg.norm(sums, axis=1)
        clear = lengths > 1e-6 * total(w * d)
        self.near("normal", found["normal"][clear], sums[clear] / lengths[clear, None], 1e-8)
        labels = measure_oracle.rank(measure_oracle.components(
            scipy.sparse.coo_matrix((np.ones(len(i), bool), (i, j)), (count, count))))
        np.testing.assert_array_equal(found["cluster"], labels)
        np.testing.assert_array_equal(found["cluster_size"], np.bincount(labels)[labels])

    def test_spray(self):
        path = self.scene("spray", 1500, "--voxel-size", "0.5")
        radius = self.report("info", path)["suggested_radius"]
        self.succeeds("convert", path, "-o", self.path("spray.npz"), "-q")
        points = np.load(self.path("spray.npz"))["positions"]
        scene = Scene(points, radius=radius)
        for kernel in KERNELS:
            found, _ = self.measured(path, SCALARS + CLUSTERS + GROUPS, "--kernel", kernel, "--mass", 3)
            self.agrees(found, scene, kernel, 3)
        self.assertGreater(found["isolated"].sum(), 0)


class Roles(MeasureCase):
    """Who asks, among whom, how far."""

    def setUp(self):
        super().setUp()
        rng = np.random.default_rng(21)
        self.points, self.probes = rng.random((350, 3)), rng.random((130, 3))
        self.points[4], self.probes[7] = np.nan, np.inf
        self.values = values_of(350)
        self.radii, self.probe_radii = rng.random(350) * 0.3, rng.random(130) * 0.3
        self.radii[[3, 50, 77, 90]], self.probe_radii[[4, 9]] = (np.nan, 0, -1, np.inf), (np.inf, -2)
        self.input, self.queries = self.npz("in.npz", self.points, self.values), self.npy("probes.npy", self.probes, np.float64)
        self.radius_file = self.npy("radii.npy", self.radii, np.float64)
        self.probe_radius_file = self.npy("probe_radii.npy", self.probe_radii, np.float64)
        self.names = SCALARS + GROUPS + ["average:" + name for name in AVERAGED]

    def check(self, scene, *args, input=None, names=None, values=None):
        for kernel in KERNELS:
            found, _ = self.measured(input or self.input, names or self.names, *args, "--kernel", kernel, "--mass-attribute", "mass",
                                     "--pca-threshold", 4)
            values = values or self.values
            self.agrees(found, scene, kernel, values["mass"], values, pca={"threshold": 4})

    def test_other_queries(self):
        self.check(Scene(self.points, self.probes, radius=0.2), "-r", 0.2, "--queries", self.queries)
        self.check(Scene(self.points, self.points, radius=0.15), "-r", 0.15, "--queries", self.input)
        self.check(Scene(self.points, self.probes, radius=0.3, nearest=5), "-r", 0.3, "--queries", self.queries, "--nearest", 5)

    def test_weights_of_zero(self):
        """Other queries whose neighbors are all at the radius: no weight, and no mean."""
        found, _ = self.measured(self.npz("in.npz", np.eye(3), {"a": np.ones(3)}), ["count", "density", "average:a", "normal"],
                                 "-r", 1, "--queries", self.npy("origin.npy", np.zeros((1, 3))))
        self.assertEqual([found[n].tolist() for n in ("count", "density", "average:a", "normal")], [[3], [0], [0], [[0, 0, 0]]])

    def test_nearest(self):
        for nearest in (1, 3, 12, 1000):
            with self.subTest(nearest):
                self.check(Scene(self.points, radius=0.25, nearest=nearest), "-r", 0.25, "--nearest", nearest)
        points = lattice(5, 0.125)  # ties
        values = values_of(len(points))
        self.check(Scene(points, radius=0.25, nearest=4), "-r", 0.25, "--nearest", 4, input=self.npz("ties.npz", points, values),
                   values=values)

    def test_radii_of_points(self):
        for mode in ("gather", "scatter", "symmetric"):
            with self.subTest(mode):
                scene = Scene(self.points, query_radii=self.radii, point_radii=self.radii, mode=mode)
                args = ("--radius-file", self.radius_file, "--radius-mode", mode)
                self.check(scene, *args, names=self.names + CLUSTERS)
                found, _ = self.measured(self.input, CLUSTERS, *args, "--min-neighbors", 5)
                self.agrees(found, scene, min_neighbors=5)
                scene = Scene(self.points, query_radii=self.radii * 0.8, point_radii=self.radii * 0.8, mode=mode, nearest=6)
                self.check(scene, *args, "--radius-scale", 0.8, "--nearest", 6)

    def test_radii_of_two_sets(self):
        files = {"gather": ["--queries-radius-file", self.probe_radius_file], "scatter": ["--radius-file", self.radius_file]}
        files["symmetric"] = files["gather"] + files["scatter"]
        for mode, flags in files.items():
            with self.subTest(mode):
                scene = Scene(self.points, self.probes, query_radii=self.probe_radii, point_radii=self.radii, mode=mode)
                self.check(scene, "--queries", self.queries, "--radius-mode", mode, *flags)

    def grid(self, points=None, voxel="0.25"):
        """A .vdb of the points, with their values; and these in its order."""
        points = self.points if points is None else points
        source = self.npz("source.npz", points, dict(self.values, pscale=self.radii.astype(np.float32)))
        self.succeeds("convert", source, "-o", self.path("in.vdb"), "--voxel-size", voxel, "-f", "-q")
        self.succeeds("convert", self.path("in.vdb"), "-o", self.path("sorted.npz"), "-f", "-q")
        with np.load(self.path("sorted.npz")) as file:
            values = {name: file[name] for name in file.files}
        return self.path("in.vdb"), values.pop("positions").astype(np.float64), values

    def test_groups_and_attributes_of_a_vdb(self):
        grid, points, values = self.grid(self.points.astype(np.float32))
        self.assertEqual(len(points), 349)
        np.testing.assert_array_equal(values["v"], self.values["v"][values["id"]])
        self.check(Scene(points, radius=0.25), "-r", 0.25, input=grid, values=values)
        fluid, wall = values["fluid"], values["wall"]
        for queries, candidates, chosen in (("fluid", None, (fluid, None)), (None, "fluid", (None, fluid)),
                                            ("fluid", "wall,^fluid", (fluid, wall & ~fluid)), ("^wall", "wall,fluid", (~wall, wall | fluid))):
            args = [*(["--query-group", queries] if queries else []), *(["--candidate-group", candidates] if candidates else [])]
            with self.subTest(args):
                self.check(Scene(points, radius=0.3, asks=chosen[0], candidates=chosen[1]), "-r", 0.3, *args, input=grid, values=values)
        for mode in ("gather", "scatter", "symmetric"):
            radii = values["pscale"].astype(float)
            scene = Scene(points, query_radii=radii, point_radii=radii, mode=mode, asks=fluid, nearest=9)
            self.check(scene, "--radius-attribute", "pscale", "--radius-mode", mode, "--query-group", "fluid", "--nearest", 9,
                       input=grid, values=values)
        self.check(Scene(points, self.probes, radius=0.3), "-r", 0.3, "--queries", self.queries, input=grid, values=values)

    def test_two_grids(self):
        """Queries in a grid that is sheared and turned."""
        points, probes = (np.fromfile(self.fixture(f"named_values_{name}.f64")).reshape(-1, 3) for name in ("points", "probes"))
        number = np.arange(len(points))
        values = {"mass": 0.05 * (1 + number % 7), "pscale": np.float32(0.05) * (1 + number % 7).astype(np.float32)}
        names = SCALARS + GROUPS + ["average:pscale", "average:mass"]
        args = ("-g", "points", "--queries-grid", "probes", "-r", 0.3)
        vdb = self.fixture("named_values.vdb")
        self.check(Scene(points, probes, radius=0.3), *args, input=vdb, names=names, values=values)
        scene = Scene(points, probes, radius=0.3, candidates=number % 2 == 0, nearest=4)
        self.check(scene, *args, "--candidate-group", "even", "--nearest", 4, input=vdb, names=names, values=values)

    def test_properties_of_a_ply(self):
        grid, points, values = self.grid(self.points.astype(np.float32))
        self.succeeds("convert", grid, "-o", self.path("in.ply"), "-q")
        rows = read_ply(self.path("in.ply"))
        values = {"mass": rows["mass"], "heat": rows["heat"], "kind": rows["kind"], "v_y": rows["v_y"]}
        out = self.path("out.ply")
        self.succeeds("search", self.path("in.ply"), "-r", 0.3, "--attributes", "density,average:heat,average:kind,average:v_y,normal,isolated,pca",
                      "--mass-attribute", "mass", "--prefix", "", "-o", out, "-q", "--pca-threshold", 5, "--keep", "none")
        rows = read_ply(out)
        self.assertEqual(rows.dtype.names, ("x", "y", "z", "density", "average:heat", "average:kind", "average:v_y", "nx", "ny", "nz",
                                            *["stretch_" + a for a in "xyz"], *["xform_" + a + b for a in "xyz" for b in "xyz"],
                                            *["pws_" + a for a in "xyz"], "isolated", "ellipsoids"))
        found = {name: rows[name] for name in ("density", "average:heat", "average:kind", "average:v_y")}
        for name in ("stretch", "pws"):
            found[name] = np.stack([rows[name + "_" + a] for a in "xyz"], 1)
        found["normal"] = np.stack([rows["n" + a] for a in "xyz"], 1)
        found["xform"] = np.stack([rows["xform_" + a + b] for a in "xyz" for b in "xyz"], 1).reshape(-1, 3, 3)
        found.update({name: rows[name].astype(bool) for name in ("isolated", "ellipsoids")})
        self.agrees(found, Scene(points, radius=0.3), mass=values["mass"], values=values, pca={"threshold": 5})

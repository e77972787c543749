"""verify on attributes: what NumPy makes of the formulas passes, in each kind of file; faults, missing values and bad flags do not."""
import json
import os
import re

import numpy as np

import cli_case
from cli_case import CliCase

RADIUS, MASS = 0.2, 0.5


def cubic(q):
    return 8 / np.pi * np.where(q <= 0.5, 1 - 6 * q ** 2 + 6 * q ** 3, 2 * (1 - q) ** 3)


def clusters(near):
    """Labels of the connected components, by their smallest numbers."""
    labels = np.arange(len(near))
    while True:
        least = np.array([min(labels[i], *labels[near[i]]) if near[i].any() else labels[i] for i in range(len(near))])
        if (least == labels).all():
            return np.unique(labels, return_inverse=True)[1]
        labels = least


def measures(x, v, radius=RADIUS):
    """Of finite points and a vector each, as search names and stores them."""
    apart = x[None, :, :] - x[:, None, :]
    distance = np.sqrt((apart ** 2).sum(axis=2))
    near = (distance <= radius) & ~np.eye(len(x), dtype=bool)
    weight = np.where(near, cubic(np.minimum(distance / radius, 1)), 0) / radius ** 3
    own = weight + np.eye(len(x)) * cubic(np.zeros(1)) / radius ** 3
    count = near.sum(axis=1)
    away = -(weight[:, :, None] * apart).sum(axis=1)
    length = np.sqrt((away ** 2).sum(axis=1, keepdims=True))
    least = np.where(near, distance, np.inf)
    isolated = count == 0
    labels = clusters(near)
    return {
        "count": count.astype(np.int32),
        "density": (MASS * own.sum(axis=1)).astype(np.float32),
        "mean_distance": np.where(isolated, -1, np.where(near, distance, 0).sum(axis=1) / np.maximum(count, 1)).astype(np.float32),
        "nearest_distance": np.where(isolated, -1, least.min(axis=1)).astype(np.float32),
        "nearest": np.where(isolated, -1, least.argmin(axis=1)).astype(np.int32),
        "average:v": ((own[:, :, None] * v[None, :, :].astype(float)).sum(axis=1) / own.sum(axis=1)[:, None]).astype(np.float32),
        "normal": np.divide(away, length, out=np.zeros_like(away), where=length > 0).astype(np.float32),
        "cluster": labels.astype(np.int32),
        "cluster_size": np.bincount(labels)[labels].astype(np.int32),
        "isolated": isolated,
        "nonfinite": np.zeros(len(x), dtype=bool),
    }


class VerifyAttributes(CliCase):
    def setUp(self):
        super().setUp()
        random = np.random.default_rng(4)
        self.x = random.random((400, 3))
        self.x[7] = 9
        self.v = random.standard_normal((400, 3)).astype(np.float32)
        self.input = self.path("cloud.npz")
        np.savez(self.input, positions=self.x, v=self.v)
        self.values = measures(self.x, self.v)

    def result(self, values, name="result.npz", prefix="nns_"):
        np.savez(self.path(name), **{prefix + key: value for key, value in values.items()})
        return self.path(name)

    def verify(self, result, *more):
        return cli_case.run("verify", self.input, result, "-r", RADIUS, "--mass", MASS, *more)

    def test_right_values_pass(self):
        result = self.result(self.values)
        for more in ([], ["--sample", "50"], ["-T", "1"]):
            done = self.verify(result, *more)
            self.assertEqual(done.code, 0, done.out + done.err)
            self.assertIn("the attributes are right", done.out)
        report = self.report("verify", self.input, result, "-r", RADIUS, "--mass", MASS)
        self.assertTrue(report["passed"])
        self.assertEqual(report["attributes"], result)
        self.assertEqual(set(report["faults"]), set(self.values))
        self.assertEqual(report["expected_pairs"], int(self.values["count"].sum()))
        for finding in report["faults"].values():
            self.assertEqual((finding["count"], finding["checked"]), (0, 400))
        some = self.report("verify", self.input, result, "-r", RADIUS, "--attributes", "count,normal")
        self.assertEqual(set(some["faults"]), {"count", "normal"})

    def test_another_prefix(self):
        result = self.result(self.values, prefix="my|")
        self.assertEqual(self.verify(result, "--prefix", "my|").code, 0)
        self.fails(2, "verify", self.input, result, "-r", RADIUS, says=["result.npz", "nns_", "--prefix"])

    def test_planted_faults(self):
        for name, values in self.values.items():
            with self.subTest(name):
                planted = dict(self.values)
                planted[name] = values.copy()
                if values.dtype == bool:
                    planted[name][31] ^= True
                elif values.dtype == np.int32:
                    planted[name][31] += 1
                else:
                    planted[name].reshape(400, -1)[31, -1] *= 1.0001
                result = self.result(planted)
                done = self.verify(result)
                self.assertEqual(done.code, 1, done.out + done.err)
                self.assertRegex(done.out, rf"(?m)^ +{name} +1 wrong of 400\n    31")
                self.assertIn(f"{result} differs from the measures", done.err)
                report = json.loads(self.verify(result, "--json", "-").out)
                self.assertFalse(report["passed"])
                self.assertEqual(report["faults"][name]["examples"][0]["query"], 31)
                self.assertEqual(sum(finding["count"] for finding in report["faults"].values()), 1)

    def test_options_count(self):
        self.assertEqual(cli_case.run("verify", self.input, self.result(self.values), "-r", RADIUS).code, 1) # the mass
        density = self.result({"density": self.values["density"]})
        self.assertEqual(self.verify(density).code, 0)
        self.assertEqual(self.verify(density, "--kernel", "poly6").code, 1)
        cores = self.result({"cluster": self.values["cluster"]})
        self.assertEqual(cli_case.run("verify", self.input, cores, "-r", RADIUS).code, 0)
        self.assertEqual(cli_case.run("verify", self.input, cores, "-r", RADIUS, "--min-neighbors", "40").code, 1)

    def test_masses_of_points(self):
        masses = np.linspace(0, 3, 400)
        distance = np.sqrt(((self.x[None] - self.x[:, None]) ** 2).sum(axis=2))
        weight = np.where(distance <= RADIUS, cubic(np.minimum(distance / RADIUS, 1)), 0) / RADIUS ** 3
        density = self.result({"density": (weight * masses).sum(axis=1).astype(np.float32)})
        np.savez(self.input, positions=self.x, v=self.v, m=masses)
        self.succeeds("verify", self.input, density, "-r", RADIUS, "--mass-attribute", "m", "-q")
        masses[20], masses[30] = -1, np.nan
        np.savez(self.input, positions=self.x, v=self.v, m=masses)
        self.fails(3, "verify", self.input, density, "-r", RADIUS, "--mass-attribute", "m",
                   says=["'m' of point 20 is -1", "2 of 400"])

    def test_files_that_search_writes(self):
        scene = self.scene("dam_break", 3000)
        counted = self.path("counted.vdb")
        self.succeeds("search", scene, "-o", counted, "-q")
        self.assertIn("count            0 wrong of 3000", self.succeeds("verify", scene, counted).out)
        self.assertEqual(cli_case.run("verify", scene, counted, "-r", "0.1", "-q").code, 1)
        self.succeeds("convert", counted, "-o", self.path("counted.ply"), "-q")
        self.succeeds("verify", scene, self.path("counted.ply"), "-q")
        # A grid that is made of an array has another order, and ids.
        self.succeeds("convert", self.input, "-o", self.path("grid.vdb"), "-q")
        self.fails(2, "verify", self.input, self.path("grid.vdb"), "-r", RADIUS, says="no attribute of a measure")
        other = self.scene("block", 3000)
        self.fails(3, "verify", other, counted, "-r", "0.1", says="counted.vdb")

    def test_what_cannot_be_checked(self):
        result = self.result(self.values)
        self.fails(2, "verify", self.input, result, "-r", RADIUS, "--attributes", "pca", says=["result.npz", "stretch"])
        self.fails(2, "verify", self.input, result, "-r", RADIUS, "--attributes", "densty", says="density")
        self.fails(2, "verify", self.input, result, "-r", RADIUS, "--attributes", "average:w", says=["w", "cloud.npz", "'v'"])
        self.fails(3, "verify", self.input, self.result({"density": self.values["density"].astype(float)}), "-r", RADIUS,
                   says=["nns_density", "double", "float"])
        self.fails(3, "verify", self.input, self.result({"density": self.values["density"][:-1]}), "-r", RADIUS,
                   says=["nns_density", "399"])
        self.fails(3, "verify", self.input, self.path("none.vdb"), "-r", RADIUS, says="none.vdb")

    def test_flags_that_do_not_go_together(self):
        result = self.result({"count": self.values["count"], "cluster": self.values["cluster"]})
        lists = self.path("lists.npz")
        self.succeeds("search", self.input, "-r", RADIUS, "-o", lists, "-q")
        for more, says in ((["--attributes", "count,"], "empty name"),
                           (["--attributes", "count,count"], "twice"),
                           (["--mass", "1"], "--mass"),
                           (["--mass", "-1"], "--mass"),
                           (["--mass", "1", "--mass-attribute", "v"], "--mass-attribute"),
                           (["--mass-attribute", "v"], "--mass-attribute"),
                           (["--kernel", "cubic"], "--kernel"),
                           (["--pca-average", "1"], "--pca-average"),
                           (["--pca-threshold", "-3"], "--pca-threshold"),
                           (["--pca-anisotropy", "0"], "--pca-anisotropy"),
                           (["--min-neighbors", "0"], "--min-neighbors"),
                           (["--attributes", "count", "--min-neighbors", "3"], "--min-neighbors"),
                           (["--nearest", "3"], "--nearest"),
                           (["--queries", self.input], "--queries"),
                           (["--prefix", "a b"], "--prefix")):
            with self.subTest(more):
                self.fails(2, "verify", self.input, result, "-r", RADIUS, *more, says=says)
        for more in (["--attributes", "count"], ["--kernel", "cubic"], ["--min-neighbors", "3"],
                     ["--mass-attribute", "v"]):
            with self.subTest(more):
                self.fails(2, "verify", self.input, lists, "-r", RADIUS, *more, says=[more[0], "lists.npz"])
        self.assertTrue(os.path.exists(lists))

    def test_the_table_of_refused_flags(self):
        """docs/cli.md says which flags of measures do not go together: search, plan and verify refuse each row by its last flag."""
        with open(os.path.join(os.path.dirname(os.path.abspath(__file__)), "..", "..", "docs", "cli.md")) as file:
            table = re.search(r"<!-- refused flags of search, plan and verify -->(.*?)<!-- end", file.read(), re.S).group(1)
        rows = [line.split("|")[1] for line in table.strip().splitlines()[2:]]
        self.assertGreater(len(rows), 15)
        for row in rows:
            flags = [flag.split() for flag in re.findall(r"`([^`]+)`", row)]
            args = [word for flag in flags for word in flag]
            with self.subTest(args):
                says = "measure" if args[-1] in ("count,count", "densty") else args[-1] if len(flags) == 1 else flags[-1][0]
                if flags[-1][0].endswith("-group") or flags[-1][0] == "--queries-grid":
                    says = "queries or groups"
                missing = self.path("missing.vdb")
                self.fails(2, "search", missing, "-r", RADIUS, "-o", self.path("out.vdb"), *args, says=says)
                self.fails(2, "plan", missing, "-r", RADIUS, *args, says=says)
                self.fails(2, "verify", missing, self.path("result.vdb"), "-r", RADIUS, *args, says=says)


ROWS = "count,density,mean_distance,nearest_distance,nearest,normal,eigenvalues,pca,isolated,nonfinite"
ALL = ROWS + ",cluster,cluster_size"


class SearchAgrees(CliCase):
    """What search writes passes: the engine's measures and the checker share the names alone."""

    def agrees(self, source, name, *flags):
        """Searches and verifies with the same flags."""
        result = self.path(name)
        output = ["--attributes-output", result] if name.endswith(".npz") else ["-o", result]
        self.succeeds("search", source, *output, "-f", "-q", *flags)
        report = self.report("verify", source, result, *flags)
        self.assertTrue(report["passed"])
        return report

    def cloud(self, name="cloud.npz", count=900, seed=8):
        random = np.random.default_rng(seed)
        x = random.random((count, 3))
        x[3], x[4] = np.nan, x[5]
        v = random.standard_normal((count, 3)).astype(np.float32)
        v[10, 1] = np.inf
        np.savez(self.path(name), positions=x, v=v, d=random.standard_normal(count), n=random.integers(-9, 9, count),
                 m=random.random(count), r=0.05 + 0.1 * random.random(count))
        return self.path(name)

    def test_scenes(self):
        for name in ("dam_break", "sheet", "clusters", "lattice", "spray", "far"):
            with self.subTest(name):
                scene = self.scene(name, 4000)
                report = self.agrees(scene, "out.vdb", "--attributes", ALL)
                self.assertEqual(len(report["faults"]), len(ALL.split(",")) + 3)
                if name != "lattice": # whose sums have no direction, and whose eigenvalues are equal
                    self.assertLess(report["faults"]["normal"]["undetermined"], 400)
                    self.assertLess(report["faults"]["xform"]["undetermined"], 400)
                self.agrees(scene, "out.ply", "--attributes", ALL, "--min-neighbors", "20", "--kernel", "poly6")
                self.agrees(scene, "out.npz", "--attributes", ROWS, "--nearest", "7", "--pca-threshold", "6")

    def test_attributes_that_are_there_are_found(self):
        source, result = self.cloud(), self.path("out.vdb")
        self.succeeds("search", source, "-r", "0.1", "-o", result, "-q", "--attributes", ALL + ",average:v,average:n")
        report = self.report("verify", source, result, "-r", "0.1")
        self.assertEqual(len(report["faults"]), len(ALL.split(",")) + 3 + 2)
        self.assertEqual(report["queries"], 899) # the .vdb has no place for the one that is not finite

    def test_points_of_arrays(self):
        source = self.cloud()
        averages = ALL + ",average:v,average:d,average:n"
        for name in ("out.vdb", "out.ply", "out.npz"):
            for flags in (["--mass-attribute", "m"], ["--mass", "3", "--pca-average", "0.5", "--pca-anisotropy", "0.1"],
                          ["--min-neighbors", "4", "--pca-threshold", "3", "--pca-stretch", "0.3"],
                          ["--kernel", "tophat", "--prefix", "p|"], ["--kernel", "wendland2"]):
                with self.subTest((name, flags)):
                    self.agrees(source, name, "-r", "0.1", "--attributes", averages, *flags)

    def test_radii_of_points(self):
        source = self.cloud()
        radii = np.load(source)["r"]
        radii[20:26] = 0, -1, np.nan, np.inf, 1e-9, 0.2
        np.save(self.path("radii.npy"), radii)
        for mode in ("gather", "scatter", "symmetric"):
            for name in ("out.ply", "out.npz"):
                with self.subTest((mode, name)):
                    self.agrees(source, name, "--radius-file", self.path("radii.npy"), "--radius-mode", mode,
                                "--attributes", ALL + ",average:v", "--pca-threshold", "5")

    def test_other_queries(self):
        source, queries = self.cloud(), self.cloud("queries.npz", 300, 9)
        for name in ("out.ply", "out.npz", "out.vdb"):
            with self.subTest(name):
                self.agrees(source, name, "-r", "0.1", "--queries", queries, "--attributes", ROWS + ",average:d")
        scene, result = self.scene("block", 3000), self.path("asked.vdb")
        self.succeeds("search", scene, "--queries", self.scene("sheet", 2000), "-r", "0.1", "-o", result, "-q",
                      "--attributes", ROWS)
        self.succeeds("verify", scene, result, "--queries", self.path("sheet.vdb"), "-r", "0.1", "-q")

    def test_other_grids(self):
        for name, radius in (("affine.vdb", "1.3"), ("nonfinite.vdb", "0.8"), ("empty.vdb", "1")):
            with self.subTest(name):
                self.agrees(self.fixture(name), "out.vdb", "-r", radius, "--attributes", ALL, "--pca-threshold", "4")
                self.succeeds("verify", self.fixture(name), self.path("out.vdb"), "-r", radius, "--attributes", "count", "-q")
        self.succeeds("verify", self.fixture("empty.vdb"), self.path("out.vdb"), "-r", "1", "-q")

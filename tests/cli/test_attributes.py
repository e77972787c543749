"""Files with measures: what stands in them beside what was there, their names and types, and every refusal."""
import os
import shutil

import numpy as np

from cli_case import run
from measure_case import MeasureCase, lattice, values_of
from test_convert import read_ply
from test_outputs import without_uuid

# What --attributes adds to a .vdb.
ADDED = {"density": [("nns_density", "float")], "count": [("nns_count", "int32")], "nearest": [("nns_nearest", "int32")],
         "mean_distance": [("nns_mean_distance", "float")], "nearest_distance": [("nns_nearest_distance", "float")],
         "average:v": [("nns_average:v", "vec3s")], "average:mass": [("nns_average:mass", "double")],
         "average:id": [("nns_average:id", "float")], "normal": [("nns_normal", "vec3s")],
         "eigenvalues": [("nns_eigenvalues", "vec3s")], "pca": [("stretch", "vec3s"), ("xform", "mat3s"), ("pws", "vec3d")],
         "cluster": [("nns_cluster", "int32")], "cluster_size": [("nns_cluster_size", "int32")], "isolated": [], "nonfinite": []}
GROUPS = ["ellipsoids", "nns_isolated", "nns_nonfinite"]


def named(attributes):
    return [(a["name"], a["type"]) for a in attributes if a["name"] != "__group"]


class Outputs(MeasureCase):
    def setUp(self):
        super().setUp()
        self.points = np.random.default_rng(9).random((600, 3))
        self.array = self.npy("x.npy", self.points, np.float64)

    def contents(self, path, *args):
        """Positions, attributes and groups."""
        self.succeeds("convert", path, "-o", self.path("contents.npz"), "-f", "-q", *args)
        with np.load(self.path("contents.npz")) as file:
            return {name: file[name] for name in file.files}

    def test_a_copy_keeps_what_was_there(self):
        source, out = self.fixture("named_values.vdb"), self.path("out.vdb")
        args = ["-g", "points", "-r", 0.3, "--pca-threshold", 5]
        report = self.report("search", source, *args, "--attributes", ",".join(ADDED), "-o", out)
        added = [one for each in ADDED.values() for one in each]
        self.assertEqual(named(report["measures"]["attributes"]), added)
        self.assertEqual(report["measures"], {"attributes": report["measures"]["attributes"], "groups": GROUPS, "skipped_values": {}, "kept": [],
                                              "left_out": [], "voxel_size": None, "largest_rounding": None})
        before, after = (self.report("info", path, "-g", "points") for path in (source, out))
        self.assertEqual(named(after["attributes"]), named(before["attributes"]) + added)
        self.assertEqual(sorted(after["groups"]), sorted(before["groups"] + GROUPS))
        for key in ("points", "transform", "bbox", "codec", "suggested_radius"):
            self.assertEqual(after[key], before[key], key)
        probes = [self.report("info", path, "-g", "probes") for path in (source, out)]
        self.assertEqual(*({k: v for k, v in info.items() if k != "path"} for info in probes))

        expected, _ = self.measured(source, list(ADDED), *args)
        with np.load(self.path("measured.npz")) as file:
            self.assertEqual(file.files, [name for name, _ in added] + GROUPS)
            expected = {name: file[name] for name in file.files}
        old, new = self.contents(source, "-g", "points"), self.contents(out, "-g", "points")
        for name, array in {**old, **expected}.items():
            self.assertEqual((new[name].dtype, new[name].tobytes()), (array.dtype, array.tobytes()), name)
        self.assertEqual(len(new), len(old) + len(expected))
        self.assertTrue(new["ellipsoids"].any() and not new["ellipsoids"].all())

    def test_groups_of_part_of_the_points(self):
        """A copy has the groups of a sparse scene, in many leaves, whoever is in them."""
        path = self.scene("spray", 3000)
        expected, _ = self.measured(path, ["isolated", "pca"], "--pca-threshold", 8)
        self.succeeds("search", path, "--attributes", "isolated,pca", "--pca-threshold", 8, "-o", self.path("out.vdb"), "-q")
        found = self.contents(self.path("out.vdb"))
        for name in ("isolated", "ellipsoids"):
            self.assertTrue(0 < expected[name].sum() < 3000)
            np.testing.assert_array_equal(found[{"isolated": "nns_isolated"}.get(name, name)], expected[name])
        # They work as groups.
        counted = self.report("search", self.path("out.vdb"), "--query-group", "nns_isolated", "--checksum")
        self.assertEqual(counted["result"]["pairs"], 0)

    def test_what_exists_is_not_replaced(self):
        path, once, target = self.scene(), self.path("once.vdb"), self.path("twice.vdb")
        self.succeeds("search", path, "--attributes", "density,pca,isolated", "-o", once, "-q")
        before = self.bytes(once)
        for names, words in (("density", ["attribute 'nns_density' exists"]), ("count,density", ["'nns_density'"]),
                             ("pca", ["'stretch'"]), ("isolated", ["group 'nns_isolated' exists"])):
            self.fails(2, "search", once, "--attributes", names, "-o", target, says=[*words, "--force"])
            self.assertEqual(self.bytes(once), before)
        # In place, too; another prefix does not help pca.
        self.fails(2, "search", once, "--attributes", "density", "-o", once, says="exists")
        self.fails(2, "search", once, "--attributes", "pca", "--prefix", "my_", "-o", target, says="'stretch'")
        self.assertEqual(self.bytes(once), before)
        self.succeeds("search", once, "--attributes", "density,isolated", "--prefix", "my_", "-o", target, "-q")
        info = self.report("info", target)
        self.assertEqual([name for name, _ in named(info["attributes"])], ["P", "nns_density", "stretch", "xform", "pws", "my_density"])
        self.assertEqual(sorted(info["groups"]), ["ellipsoids", "my_isolated", "nns_isolated"])
        # With --force the values are those of the search, and no name stands there twice.
        for out in (target, once):
            self.succeeds("search", once, "-r", 0.05, "--attributes", "density,pca,isolated", "--kernel", "tophat", "-f", "-o", out, "-q")
            found, expected = self.contents(out), self.measured(path, ["density", "pca", "isolated"], "-r", 0.05, "--kernel", "tophat")[0]
            for name, array in expected.items():
                prefix = "" if name in ("stretch", "xform", "pws", "ellipsoids") else "nns_"
                np.testing.assert_array_equal(found[prefix + name], array, name)
            names = [name for name, _ in named(self.report("info", out)["attributes"])]
            self.assertEqual(sorted(names), ["P", "nns_density", "pws", "stretch", "xform"])
        # Arrays have no such names, nor have points of other formats that they do not come along into.
        self.succeeds("search", target, "--attributes", "pca", "--attributes-output", self.path("a.npz"), "-o", self.path("a.ply"), "-q",
                      "--keep", "none")

    def test_an_attribute_of_another_type_is_replaced(self):
        source = self.npz("x.npz", self.points, {"nns_density": np.ones((600, 3), np.float32), "nns_count": np.arange(600.0)})
        self.succeeds("convert", source, "-o", self.path("x.vdb"), "-q")
        self.fails(2, "search", self.path("x.vdb"), "-r", 0.1, "-o", self.path("y.vdb"), says="'nns_count'")
        self.succeeds("search", self.path("x.vdb"), "-r", 0.1, "--attributes", "density,count", "-o", self.path("x.vdb"), "-f", "-q")
        self.assertEqual(named(self.report("info", self.path("x.vdb"))["attributes"]),
                         [("P", "vec3s"), ("id", "int32"), ("nns_density", "float"), ("nns_count", "int32")])

    def test_a_new_grid_from_arrays(self):
        self.points[[5, 300]] = np.nan
        self.array, out = self.npy("x.npy", self.points, np.float64), self.path("x.vdb")
        expected, _ = self.measured(self.array, ["density", "pca", "cluster", "isolated", "nonfinite"], "-r", 0.15)
        for args, voxel in (([], 0.15), (["--voxel-size", 0.4], 0.4), (["--voxel-size", 0.25], 0.25)):
            report = self.report("search", self.array, "-r", 0.15, "--attributes", "density,pca,cluster,isolated,nonfinite", "-o", out,
                                 "-f", *args)
            info = self.report("info", out)
            self.assertEqual((info["grid"], info["points"], info["suggested_radius"]), ("points", 598, 0.15))
            self.assertEqual((info["voxel_size"], report["measures"]["voxel_size"]), ([voxel] * 3, voxel))
            self.assertEqual(named(info["attributes"]), [("P", "vec3s"), ("id", "int32"), ("nns_density", "float"), *ADDED["pca"],
                                                         ("nns_cluster", "int32")])
            self.assertEqual(sorted(info["groups"]), GROUPS)
            found = self.contents(out)
            numbers = found["id"]
            self.assertEqual(sorted(set(range(600)) - set(numbers)), [5, 300])
            for name, array in expected.items():
                prefix = "" if name in ("stretch", "xform", "pws", "ellipsoids") else "nns_"
                np.testing.assert_array_equal(found[prefix + name], array[numbers], name)
            error = np.linalg.norm(found["positions"] - self.points[numbers], axis=1).max()
            self.assertGreater(report["measures"]["largest_rounding"], 0)
            self.assertLessEqual(error, report["measures"]["largest_rounding"] * 1.001 + 1e-16)
        done = self.succeeds("search", self.array, "-r", 0.15, "-o", out, "-f", "--attributes", "count")
        self.assertIn("2 points with a NaN or infinite coordinate are left out", done.err)
        self.assertIn("positions were rounded by up to", done.err)
        # No rounding, no warning.
        floats = self.npy("f.npy", lattice(8, 0.125))
        report = self.report("search", floats, "-r", 0.25, "-o", out, "-f")
        self.assertEqual(report["measures"]["largest_rounding"], 0)
        self.assertEqual(self.succeeds("search", floats, "-r", 0.25, "-o", out, "-f").err, "")
        self.assertEqual(self.succeeds("search", self.array, "-r", 0.15, "-o", out, "-f", "-q").err, "")
        # It is found again with the radius that it suggests.
        self.assertEqual(self.report("search", out, "--checksum")["radius"]["world"], 0.15)

    def test_the_same_new_grid(self):
        files = []
        for threads in (1, 2, 8):
            self.succeeds("search", self.array, "-r", 0.15, "--attributes", "density,pca,isolated", "-o", self.path(f"{threads}.vdb"),
                          "-T", threads, "-q")
            files.append(without_uuid(self.path(f"{threads}.vdb")))
        self.assertEqual(files, files[:1] * 3)

    def test_properties(self):
        out = self.path("x.ply")
        report = self.report("search", self.array, "-r", 0.15, "--attributes", "count,density,nearest,normal,eigenvalues,pca,isolated",
                             "-o", out)
        self.assertEqual((report["measures"]["voxel_size"], report["measures"]["largest_rounding"]), (None, None))
        types = read_ply(out).dtype
        self.assertEqual([(name, types[name].str) for name in types.names],
                         [("x", "<f8"), ("y", "<f8"), ("z", "<f8"), ("nns_count", "<i4"), ("nns_density", "<f4"), ("nns_nearest", "<i4"),
                          *(("nns_normal_" + a, "<f4") for a in "xyz"), *(("nns_eigenvalues_" + a, "<f4") for a in "xyz"),
                          *(("stretch_" + a, "<f4") for a in "xyz"), *(("xform_" + a + b, "<f4") for a in "xyz" for b in "xyz"),
                          *(("pws_" + a, "<f8") for a in "xyz"), ("ellipsoids", "|u1"), ("nns_isolated", "|u1")])
        with np.load(self.arrays("count,density,nearest,normal,eigenvalues,pca,isolated")) as file:
            rows = read_ply(out)
            np.testing.assert_array_equal(rows["nns_density"], file["nns_density"])
            np.testing.assert_array_equal(rows["nns_isolated"], file["nns_isolated"])
            np.testing.assert_array_equal(rows["xform_xy"], file["xform"][:, 0, 1])
        np.testing.assert_array_equal(np.stack([rows[a] for a in "xyz"], 1), self.points)

    def arrays(self, names, *args):
        self.succeeds("search", self.array, "-r", 0.15, "--attributes", names, "--attributes-output", self.path("a.npz"), "-f", "-q", *args)
        return self.path("a.npz")

    def test_names(self):
        for prefix, expected in (([], "nns_"), (["--prefix", ""], ""), (["--prefix", "a:b|c_"], "a:b|c_")):
            with np.load(self.arrays("isolated,density,pca,nonfinite,count", *prefix)) as file:
                self.assertEqual(file.files, [expected + "density", "stretch", "xform", "pws", expected + "count", expected + "isolated",
                                              "ellipsoids", expected + "nonfinite"])
                self.assertEqual([file[name].dtype for name in file.files[-3:]], [np.bool_] * 3)
                self.assertEqual([file[name].shape for name in file.files], [(600,), (600, 3), (600, 3, 3), (600, 3)] + [(600,)] * 4)
        with np.load(self.arrays(" density , count ")) as file:
            self.assertEqual(file.files, ["nns_density", "nns_count"])
        # Without --attributes it is the count.
        self.succeeds("search", self.array, "-r", 0.15, "--attributes-output", self.path("b.npz"), "-q")
        with np.load(self.path("b.npz")) as file:
            self.assertEqual(file.files, ["nns_count"])

    def test_the_report_and_the_summary(self):
        values = values_of(600)
        path = self.npz("v.npz", self.points, values)
        args = ["search", path, "-r", 0.15, "--attributes", "average:heat,average:kind,isolated,average:vd", "--attributes-output",
                self.path("a.npz"), "-f"]
        report = self.report(*args)
        self.assertEqual(named(report["measures"]["attributes"]),
                         [("nns_average:heat", "float"), ("nns_average:kind", "float"), ("nns_average:vd", "vec3d")])
        self.assertEqual(report["measures"]["groups"], ["nns_isolated"])
        self.assertEqual(report["measures"]["skipped_values"], {"heat": 86, "vd": 86})
        text = self.succeeds(*args).out
        for word in ("nns_average:heat (float)", "nns_isolated (group)", "86"):
            self.assertIn(word, text)
        self.assertIsNone(self.report("search", path, "-r", 0.15)["measures"])

    def test_values_go_to_the_queries(self):
        queries = self.scene("block", 300)
        out = self.path("out.vdb")
        args = ["--queries", queries, "-r", 0.2, "--attributes", "density,nearest,isolated"]
        self.succeeds("search", self.array, *args, "-o", out, "-q")
        self.assertEqual(named(self.report("info", out)["attributes"]), [("P", "vec3s"), ("nns_density", "float"), ("nns_nearest", "int32")])
        found, expected = self.contents(out), self.measured(self.array, ["density", "nearest", "isolated"], "--queries", queries, "-r", 0.2)[0]
        for name, array in expected.items():
            self.assertEqual(len(array), 300)
            np.testing.assert_array_equal(found["nns_" + name], array)
        self.fails(2, "search", self.array, *args, "--voxel-size", 1, "-o", self.path("b.vdb"), says="--voxel-size")

    def kept(self, source, out, *args):
        """Names and types of what came along, what was left out, and what the file then holds beside the measure."""
        report = self.report("search", source, "-r", 0.1, "--attributes", "density", "-o", out, "-f", *args)
        found = self.contents(out)
        self.assertIn("nns_density", found)
        kept = named(report["measures"]["kept"])
        self.assertEqual(set(found) - {"positions", "nns_density", "id"}, {name for name, _ in kept} - {"id"})
        return kept, report["measures"]["left_out"], found

    def test_values_of_the_input_come_along(self):
        values = values_of(600)
        source = self.npz("v.npz", self.points, values)
        types = {"heat": "float", "work": "double", "v": "vec3s", "vd": "vec3d", "kind": "int32", "big": "int64", "mass": "double",
                 "fluid": "group", "wall": "group"}
        for args, names in (([], list(types)), (["--keep", "all"], list(types)), (["--keep", "none"], []),
                            (["--keep", "mass, fluid,kind"], ["kind", "mass", "fluid"])):
            kept, left_out, found = self.kept(source, self.path("x.vdb"), *args)
            self.assertEqual((kept, left_out), ([(name, types[name]) for name in names], []))
            for name in names:
                np.testing.assert_array_equal(found[name], values[name][found["id"]], name)
        kept, left_out, _ = self.kept(source, self.path("x.ply"), "--keep", "none")
        self.assertEqual((kept, left_out), ([], []))
        # Properties are the file's, then the measures; groups become properties too.
        self.succeeds("search", source, "-r", 0.1, "--attributes", "density,isolated", "-o", self.path("x.ply"), "-f", "-q",
                      "--keep", "v,fluid,mass")
        rows = read_ply(self.path("x.ply"))
        self.assertEqual(list(rows.dtype.names), ["x", "y", "z", "v_x", "v_y", "v_z", "mass", "nns_density", "fluid", "nns_isolated"])
        np.testing.assert_array_equal(rows["fluid"], values["fluid"])
        np.testing.assert_array_equal(rows["v_y"], values["v"][:, 1])
        # From a .ply, and from a .vdb into a .ply, with those of its groups.
        kept, _, found = self.kept(self.path("x.ply"), self.path("y.vdb"), "--prefix", "nns_", "--keep", "mass,v_y")
        self.assertEqual(kept, [("v_y", "float"), ("mass", "double")])
        np.testing.assert_array_equal(found["mass"], values["mass"][found["id"]])
        grid = self.fixture("named_values.vdb")
        before = self.contents(grid, "-g", "points")
        self.succeeds("search", grid, "-g", "points", "-r", 0.1, "-o", self.path("z.ply"), "-q")
        rows = read_ply(self.path("z.ply"))
        for name in ("mass", "id", "even"):
            np.testing.assert_array_equal(rows[name], before[name], name)
        text = self.succeeds("search", source, "-r", 0.1, "-o", self.path("x.ply"), "-f", "--keep", "mass,fluid").out
        self.assertRegex(text, r"(?m)^kept +mass \(double\)\nkept +fluid \(group\)$")

    def test_what_comes_along_into_several_files(self):
        """Each file has what it can; of the queries where they are another file."""
        source = self.npz("v.npz", self.points, {"a-b": np.arange(600.0), "id": np.arange(600), "mass": np.ones(600), "s": np.zeros(600, "S3")})
        outs = ["-o", self.path("x.vdb"), "-o", self.path("x.ply"), "--attributes-output", self.path("x.npz")]
        done = self.succeeds("search", source, "-r", 0.1, "--attributes", "density", *outs)
        for name in ("a-b is a name that OpenVDB", "id is the name of the attribute", "s "):
            self.assertIn("warning: left out: " + name, done.err)
        self.assertRegex(done.out, r"left out +a-b ")
        self.assertEqual(set(self.contents(self.path("x.vdb"))), {"positions", "id", "mass", "nns_density"})
        self.assertEqual(read_ply(self.path("x.ply")).dtype.names, ("x", "y", "z", "a-b", "id", "mass", "nns_density"))
        with np.load(self.path("x.npz")) as file:
            self.assertEqual(file.files, ["nns_density"])
        self.assertNotIn("left out", self.succeeds("search", source, "-r", 0.1, *outs[:2], "-f", "--keep", "none").err)
        self.succeeds("search", self.array, "-r", 0.1, "--queries", source, "-o", self.path("q.ply"), "--keep", "mass", "-q")
        self.assertIn("mass", read_ply(self.path("q.ply")).dtype.names)
        for out, keep, code, says in (("y.vdb", "a-b", 2, "'a-b' is a name that OpenVDB"), ("y.vdb", "id", 2, "'id'"), ("y.ply", "s", 3, "'s'"),
                                      ("y.ply", "mas", 2, "did you mean 'mass'?"), ("y.ply", "mass,,id", 2, "empty name"), ("y.ply", "", 2, "--keep")):
            self.fails(code, "search", source, "-r", 0.1, "-o", self.path(out), "--keep", keep, says=says)
        self.fails(2, "search", self.scene(), "-o", self.path("y.vdb"), "--keep", "P", says="--keep is about")

    def test_integers_that_a_ply_cannot_hold(self):
        source = self.npz("v.npz", self.points, {"big": np.arange(600) + 2**53, "fits": np.full(600, 2**53), "small": -np.arange(600)})
        done = self.succeeds("search", source, "-r", 0.1, "-o", self.path("x.ply"), "-o", self.path("x.vdb"))
        self.assertIn("warning: left out: big has integers beyond 2^53", done.err)
        self.assertEqual(read_ply(self.path("x.ply")).dtype.names, ("x", "y", "z", "fits", "small", "nns_count"))
        self.assertIn("big", self.contents(self.path("x.vdb")))
        self.fails(3, "search", source, "-r", 0.1, "-o", self.path("lists.npz"), "-o", self.path("y.ply"), "--keep", "big",
                   says=["'big' has integers beyond 2^53", "--keep"])

    def test_what_comes_along_gives_way_to_measures(self):
        once, again = self.path("once.ply"), self.path("again.ply")
        self.succeeds("search", self.array, "-r", 0.1, "--attributes", "density,normal,isolated", "-o", once, "-q")
        for names, word in (("density", "'nns_density' exists"), ("normal", "'nns_normal_x' exists"), ("isolated", "'nns_isolated' exists")):
            self.fails(2, "search", once, "-r", 0.2, "--attributes", names, "-o", again, says=[word, "--force", "--prefix", "--keep"])
        self.succeeds("search", once, "-r", 0.2, "--attributes", "density,normal", "-o", again, "-q", "-f")
        rows, expected = read_ply(again), self.measured(self.array, ["density", "normal"], "-r", 0.2)[0]
        self.assertEqual(sorted(rows.dtype.names), sorted(read_ply(once).dtype.names))
        np.testing.assert_array_equal(rows["nns_density"], expected["density"])
        np.testing.assert_array_equal(rows["nns_normal_z"], expected["normal"][:, 2])
        np.testing.assert_array_equal(rows["nns_isolated"], read_ply(once)["nns_isolated"])
        self.succeeds("search", once, "-r", 0.2, "-o", again, "--keep", "nns_density", "-q", "-f")
        self.assertEqual(read_ply(again).dtype.names, ("x", "y", "z", "nns_density", "nns_count"))

    def test_several_outputs_at_once(self):
        outs = [self.path(name) for name in ("a.npz", "b.vdb", "c.ply", "d.npz")]
        report = self.report("search", self.array, "-r", 0.2, "--attributes", "density", "--attributes-output", outs[3],
                             *[word for out in outs[:3] for word in ("-o", out)])
        self.assertEqual(len(np.load(outs[0])["indices"]), report["result"]["pairs"])
        numbers = self.contents(outs[1])["id"]
        density = np.load(outs[3])["nns_density"]
        np.testing.assert_array_equal(read_ply(outs[2])["nns_density"], density)
        np.testing.assert_array_equal(self.contents(outs[1])["nns_density"], density[numbers])


class Refused(MeasureCase):
    """Exit code and message, and nothing is written."""

    def setUp(self):
        super().setUp()
        rng = np.random.default_rng(10)
        bad, nan = rng.random(200), rng.random(200)
        bad[[3, 8]], nan[[4, 5, 6]] = -0.5, np.nan
        self.values = {"velocity": rng.random((200, 3)).astype(np.float32), "mass": rng.random(200), "bad": bad, "nan": nan,
                       "fluid": rng.random(200) < 0.5, "axes": rng.random((200, 3, 3)).astype(np.float32)}
        self.points = rng.random((200, 3))
        self.array = self.npz("in.npz", self.points, self.values)
        self.vdb = self.path("in.vdb")
        self.succeeds("convert", self.array, "-o", self.vdb, "-q")
        self.out = ["--attributes-output", self.path("out.npz")]

    def refused(self, code, input, names, *args, says, out=None):
        self.fails(code, "search", input, "-r", 0.2, "--attributes", names, *(self.out if out is None else out), *args, says=says)

    def test_names_of_measures(self):
        for names, says in (("densty", "'densty' is no measure; did you mean 'density'?"), ("count,clusters", "did you mean 'cluster'?"),
                            ("average", "did you mean 'average:NAME'?"), ("zzzzzz", "the measures are count, density, mean_distance"),
                            ("Density", "no measure"), ("density,count,density", "'density' is given twice"),
                            ("average:mass,average:mass", "'average:mass' is given twice"), ("average:", "lacks the name"),
                            ("", "empty"), (",", "empty name"), ("count,,density", "empty name"), ("count,", "empty name"),
                            ("density\n", "no measure"), ("nns_density", "no measure")):
            with self.subTest(names):
                for input in (self.array, self.path("missing.vdb")):  # before a byte is read
                    self.refused(2, input, names, says=["--attributes" if "empty" in says else "", says])

    def test_names_of_attributes(self):
        for input, words in ((self.array, ["did you mean 'velocity'? It has 'velocity', 'mass'"]),
                             (self.vdb, ["did you mean 'velocity'?", "attributes are 'P', 'id', 'velocity'"])):
            self.refused(2, input, "average:velocty", says=["no ", "'velocty'", *words])
            self.refused(2, input, "density", "--mass-attribute", "velocty", says=["no ", "'velocty'", *words])
            self.refused(2, input, "average:zz,pca", says=["'zz'"])
            self.refused(3, input, "average:fluid", says=["average:fluid", "'fluid' has type", "averages are made of"])
            self.refused(3, input, "average:axes", says=["average:axes", "'axes' has type"])
            self.refused(3, input, "density", "--mass-attribute", "velocity", says=["--mass-attribute", "masses are one number"])
            self.refused(3, input, "density", "--mass-attribute", "fluid", says=["--mass-attribute", "masses are one number"])
            self.refused(3, input, "density", "--mass-attribute", "bad", says=["-0.5", "2 of 200", "negative"])
            self.refused(3, input, "density", "--mass-attribute", "nan", says=["nan", "3 of 200"])
        self.refused(2, self.npy("x.npy", self.points), "average:v", says=["no values named 'v'", "a .vdb, a .ply and an .npz"])
        # Positions are none.
        ply = self.path("in.ply")
        self.succeeds("convert", self.array, "-o", ply, "--keep", "mass", "-q")
        for input, name in ((self.vdb, "P"), (ply, "y"), (self.array, "positions")):
            self.refused(2, input, "average:" + name,
                         says=[f"'{name}' is the position", "averages are made of float", "pws of pca with --pca-average 1"])
            self.refused(2, input, "density", "--mass-attribute", name, says=[f"'{name}' is the position", "masses are one number"])
        # Attributes are those of IN, not of other queries.
        self.refused(2, self.npy("x.npy", self.points), "average:mass", "--queries", self.array, says="no values named 'mass'")

    def test_numbers(self):
        for names, flag, values in (("density", "--mass", ("-1", "nan", "inf", "1kg", "1e999")),
                                    ("pca", "--pca-anisotropy", ("0", "1.01", "-1", "nan")), ("pca", "--pca-stretch", ("nan", "inf", "x")),
                                    ("pca", "--pca-threshold", ("-1", "1.5", "4294967296", "99999999999999999999999")),
                                    ("pca", "--pca-average", ("-0.1", "1.1", "nan")),
                                    ("cluster", "--min-neighbors", ("0", "-2", "2.5", "4294967296", "few")),
                                    ("density", "--kernel", ("gauss", "Cubic"))):
            for value in values:
                with self.subTest(flag, value=value):
                    self.refused(2, self.path("missing.npz"), names, flag, value, says=flag)
        for names, flag, value in (("cluster", "--min-neighbors", "4294967295"), ("pca", "--pca-threshold", "4294967295")):
            self.measured(self.array, [names], "-r", 0.2, flag, value)

    def test_flags_about_other_measures(self):
        for names, flag, value in (("pca,count", "--kernel", "cubic"), ("normal", "--mass", "1"), ("normal", "--mass-attribute", "mass"),
                                   ("density", "--min-neighbors", "3"), ("eigenvalues", "--pca-stretch", "1"),
                                   ("count", "--pca-threshold", "20")):
            self.refused(2, self.path("missing.vdb"), names, flag, value, says=[flag + " is about", "--attributes"])
        self.refused(2, self.array, "density", "--mass", "2", "--mass-attribute", "mass", says="do not go together")

    def test_clusters_of_one_set(self):
        for name in ("cluster", "cluster_size"):
            for flags, words in ((["--nearest", "3"], ["--nearest"]), (["--queries", self.array], ["--queries"]),
                                 (["--query-group", "fluid"], ["--query-group"]), (["--candidate-group", "fluid"], ["--candidate-group"]),
                                 (["--queries-grid", "points"], ["--queries"])):
                self.refused(2, self.vdb, name, *flags, says=[name + " does not go together with", *words])

    def test_where_measures_go(self):
        for out in ([], ["-o", self.path("lists.npz")], ["--checksum"]):
            self.refused(2, self.array, "density", out=out, says=["nothing is written that could hold density", "--attributes-output"])
        for name in ("x.txt", "x.vdb", "x", "x.npy"):
            self.refused(2, self.array, "density", out=["--attributes-output", self.path(name)], says=["--attributes-output", "extension"])
        self.refused(2, self.array, "density", out=["-o", self.path("x.bgeo")], says="extension")
        self.refused(2, self.array, "density", out=["-o", self.path("x.npz"), "--attributes-output", self.path("x.npz")],
                     says="two outputs")
        existing = self.text("old.npz", "old")
        self.refused(2, self.array, "density", out=["--attributes-output", existing], says=["old.npz", "--force"])
        self.assertEqual(self.bytes(existing), b"old")
        self.refused(6, self.array, "density", out=["--attributes-output", self.path("no/such/folder.npz")], says="folder")

    def test_an_output_that_is_the_input(self):
        before = self.bytes(self.array)
        os.link(self.array, self.path("same.npz"))
        shutil.copy(self.array, self.path("queries.npz"))
        for path in (self.array, self.path("same.npz")):
            self.refused(2, self.array, "density", out=["--attributes-output", path], says=os.path.basename(path))
            # Arrays of measures have no positions: nothing is left of the points.
            self.refused(2, self.array, "density", "--force", out=["--attributes-output", path], says="is an input and would be lost")
        self.refused(2, self.array, "density", "--queries", self.path("queries.npz"), "-f",
                     out=["--attributes-output", self.path("queries.npz")], says="would be lost")
        self.refused(2, self.vdb, "density", out=["-o", self.vdb], says="in.vdb")
        self.assertEqual((self.bytes(self.array), self.bytes(self.path("queries.npz"))), (before, before))

    def test_voxels(self):
        refused = "--voxel-size is that of a new .vdb"
        self.refused(2, self.vdb, "density", "--voxel-size", 1, out=["-o", self.path("x.vdb")], says=refused)
        self.refused(2, self.array, "density", "--voxel-size", 1, says=refused)
        self.refused(2, self.array, "density", "--voxel-size", 1, out=["-o", self.path("x.ply")], says=refused)
        for size in ("0", "-1", "nan", "inf", "x", ""):
            self.refused(2, self.path("missing.npz"), "density", "--voxel-size", size, out=["-o", self.path("x.vdb")], says="--voxel-size")
        for before in ([], ["-o", self.path("lists.npz")], ["-o", self.path("x.ply")]):  # no other output is written, either
            self.refused(3, self.array, "density", "--voxel-size", 1e-12, out=[*before, "-o", self.path("x.vdb")],
                         says=["x.vdb", "voxels of 1e-12", "give a --voxel-size of at least"])
        # What the message names works.
        done = run("search", self.array, "-r", "0.2", "-o", self.path("x.vdb"), "--voxel-size", "1e-12")
        self.succeeds("search", self.array, "-r", "0.2", "-o", self.path("x.vdb"), "--voxel-size", done.err.split()[-1], "-q")

    def test_ellipsoids_that_exist(self):
        self.succeeds("search", self.vdb, "-r", 0.2, "--attributes", "pca", "-o", self.path("once.vdb"), "-q")
        before = self.bytes(self.path("once.vdb"))
        self.refused(2, self.path("once.vdb"), "pca", out=["-o", self.path("twice.vdb")], says=["'stretch' exists", "--force"])
        source = self.npz("xform.npz", self.points, {"xform": np.zeros((200, 3, 3), np.float32)})
        self.succeeds("convert", source, "-o", self.path("xform.vdb"), "-q")
        self.refused(2, self.path("xform.vdb"), "density,pca", out=["-o", self.path("twice.vdb"), *self.out], says="'xform' exists")
        self.assertEqual(self.bytes(self.path("once.vdb")), before)

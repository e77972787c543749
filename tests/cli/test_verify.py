"""verify: passes what is right, finds each kind of fault that is planted."""
import os
import zipfile

import numpy as np

import cli_case
from cli_case import CliCase, limit_address_space


class Verify(CliCase):
    def setUp(self):
        super().setUp()
        positions = np.random.default_rng(3).random((1500, 3)).astype(np.float32)
        self.input = self.npy("cloud.npy", positions)
        self.lists = self.path("lists.npz")
        self.succeeds("search", self.input, "-r", "0.1", "-o", self.lists, "--lists", "distance", "-q")
        self.arrays = dict(np.load(self.lists))

    def write(self, arrays):
        """A valid file of other lists: ZIP and checksums are right, what they say is not."""
        path = self.path("planted.npz")
        with zipfile.ZipFile(path, "w", zipfile.ZIP_STORED) as archive:
            for name in ("indptr", "indices", "data", "shape", "format"):
                with archive.open(name + ".npy", "w") as member:
                    np.lib.format.write_array(member, np.asarray(arrays[name]))
        return path

    def row_with(self, neighbors):
        return int(np.argmax(np.diff(self.arrays["indptr"]) >= neighbors))

    def drop(self, entry):
        """Without one pair."""
        arrays = dict(self.arrays)
        row = np.searchsorted(arrays["indptr"], entry, side="right") - 1
        arrays["indices"] = np.delete(arrays["indices"], entry)
        arrays["data"] = np.delete(arrays["data"], entry)
        arrays["indptr"] = arrays["indptr"].copy()
        arrays["indptr"][row + 1:] -= 1
        return arrays

    def replaced(self, name, entry, value):
        arrays = dict(self.arrays)
        arrays[name] = arrays[name].copy()
        arrays[name][entry] = value
        return arrays

    def finds(self, kind, arrays, *more):
        path = self.write(arrays)
        done = cli_case.run("verify", self.input, path, "-r", "0.1", *more)
        self.assertEqual(done.code, 1, done.out + done.err)
        self.assertRegex(done.out, rf"(?m)^ +{kind} +[1-9]")
        self.assertIn("planted.npz", done.err)
        self.assertTrue(done.err.startswith("vdb_nns: error: "), done.err)

    def test_right_lists_pass(self):
        for args in ([], ["--sample", "100"], ["--sample", "100", "--seed", "9"], ["-T", "1"]):
            self.assertIn("right", self.succeeds("verify", self.input, self.lists, "-r", "0.1", *args).out)
        self.assertEqual(self.succeeds("verify", self.input, self.lists, "-r", "0.1", "-q"), (0, "", ""))
        self.assertTrue(self.report("verify", self.input, self.write(self.arrays), "-r", "0.1")["passed"])

    def test_planted_faults(self):
        row = self.row_with(4)
        first = int(self.arrays["indptr"][row])
        indices, data = self.arrays["indices"], self.arrays["data"]
        stranger = next(j for j in range(1500) if j != row and j not in
                        indices[first:int(self.arrays["indptr"][row + 1])])
        self.finds("missing", self.drop(first + 1))
        self.finds("extra", self.replaced("indices", first + 1, stranger))
        self.finds("self", self.replaced("indices", first + 1, row))
        self.finds("duplicate", self.replaced("indices", first + 1, indices[first]))
        self.finds("out of range", self.replaced("indices", first + 1, 1500))
        self.finds("out of range", self.replaced("indices", first + 1, -1))
        self.finds("wrong distance", self.replaced("data", first + 1, np.float32(data[first + 1] * 1.001)))
        swapped = self.replaced("indices", slice(first, first + 2), indices[first:first + 2][::-1])
        swapped["data"] = data.copy()
        swapped["data"][first:first + 2] = data[first:first + 2][::-1]
        self.finds("unsorted", swapped)
        self.finds("missing", self.drop(first + 1), "--sample", "1500")

    def test_another_radius_is_a_fault(self):
        done = cli_case.run("verify", self.input, self.lists, "-r", "0.1001")
        self.assertEqual(done.code, 1)
        self.assertRegex(done.out, r"(?m)^ +missing +[1-9]")
        self.assertIn("ulp", done.out)

    def test_report_names_the_pair(self):
        row = self.row_with(4)
        path = self.write(self.drop(int(self.arrays["indptr"][row])))
        done = cli_case.run("verify", self.input, path, "-r", "0.1", "--json", "-")
        self.assertEqual(done.code, 1)
        import json
        missing = json.loads(done.out)["faults"]["missing"]
        self.assertEqual((missing["count"], missing["examples"][0]["query"]), (1, row))
        self.assertLess(missing["examples"][0]["ulps"], 0)

    def test_lists_of_other_points_or_no_lists(self):
        other = self.npy("other.npy", np.zeros((3, 3)))
        self.fails(3, "verify", other, self.lists, "-r", "0.1", says=f"error: {self.lists}: has")
        missing = self.path("missing.npz")
        self.fails(3, "verify", self.input, missing, "-r", "0.1", says=f"error: {missing}: cannot")
        self.fails(3, "verify", self.input, self.input, "-r", "0.1", says="cloud.npy")
        with open(self.lists, "rb") as file:
            data = file.read()
        for size in (0, 100, len(data) // 2, len(data) - 1):
            done = self.fails(3, "verify", self.input, self.text("cut.npz", data[:size]), "-r", "0.1")
            self.assertIn(f"error: {self.path('cut.npz')}: ", done.err) # the lists' file alone
            self.assertNotIn("cloud.npy", done.err)
        self.fails(2, "verify", self.input, self.lists, "-r", "0")
        self.fails(2, "verify", self.input, self.lists, "-r", "0.1", "--sample", "0", says="--sample")
        self.fails(2, "verify", self.input, self.lists)

    def test_files_of_other_programs(self):
        """All that is kept with the tests: what search reads, verify's own readers understand alike."""
        columns = {"kitti_n4.npy": ("--columns", "0,1,2")}
        refused = {"undeclared_uv_points.ply", "undeclared_uv_points_bin.ply", "more_rows_than_header.ply"}
        for name in sorted(os.listdir(self.data(""))):
            with self.subTest(name):
                args = (self.data(name), "-r", "300" if name == "int_xyz.ply" else "0.3", *columns.get(name, ()))
                if name in refused:
                    self.fails(3, "search", *args, says=name)
                    self.fails(3, "verify", args[0], self.lists, *args[1:], says=name)
                    continue
                lists = self.path(name + ".npz")
                self.succeeds("search", *args, "-o", lists, "-q")
                self.succeeds("verify", args[0], lists, *args[1:])

    def test_too_little_memory(self):
        """Lists that do not fit are no fault of their file; a way of reading that needs less may pass."""
        points, large = self.npy("one_point.npy", np.zeros((4000, 3))), self.path("large.npz") # 80 MB
        self.succeeds("search", points, "-r", "1", "-o", large, "-q")

        def verify(megabytes, *files):
            return cli_case.run("verify", *files, "-r", "0.1", "-T", "1", "--sample", "10", "-q",
                                preexec_fn=limit_address_space(megabytes << 20))
        least = next(m for m in range(64, 4096, 8) if verify(m, self.input, self.lists).code == 0)
        for more in (16, 32, 48):
            done = verify(least + more, points, large)
            self.assertIn(done.code, (0, 4), done.err)
            self.assertNotIn("--encoding", done.err) # verify has no such flag

    def test_every_scene_verifies(self):
        for name in ("block", "clusters", "lattice", "seam", "far", "sheet", "spray", "dam_break"):
            path = self.scene(name, 3000)
            for args in (["--encoding", "index"], ["--encoding", "mask", "--cell-size", "0.5"]):
                out = self.path(name + ".npz")
                self.succeeds("search", path, "-o", out, "-f", "-q", *args)
                self.succeeds("verify", path, out, "-q")
        self.assertTrue(os.path.exists(self.path("block.npz")))

    def test_other_inputs_verify(self):
        for path, radius in ((self.fixture("affine.vdb"), "1.3"), (self.fixture("nonfinite.vdb"), "0.8"),
                             (self.fixture("empty.vdb"), "1")):
            out = self.path("x.npz")
            self.succeeds("search", path, "-r", radius, "-o", out, "-f", "-q", "--lists", "distance")
            self.succeeds("verify", path, out, "-r", radius, "-q")

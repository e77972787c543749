"""Tiles: parts that are merged into the bytes of one search, whatever the points and flags; parts that do not go together."""
import glob
import os
import shutil
import zipfile

import numpy as np
import scipy.sparse

import cli_case
from cli_case import CliCase


class Tiles(CliCase):
    def parts(self, tiles, *command):
        """The parts of a search, as files."""
        for path in glob.glob(self.path("part.*.npz")):
            os.remove(path)
        paths = [self.path(f"part.{k}.npz") for k in range(1, tiles + 1)]
        for k, path in enumerate(paths, 1):
            self.succeeds(*command, "--tile", f"{k}/{tiles}", "-o", path, "-q")
        return paths

    def same(self, tiles, *command):
        """Merges the parts, and holds them against one search."""
        self.succeeds(*command, "-o", self.path("one.npz"), "-q", "-f")
        paths = self.parts(tiles, *command)
        self.succeeds("merge", *paths[::-1], "-o", self.path("all.npz"), "-q", "-f")
        self.assertEqual(self.bytes(self.path("all.npz")), self.bytes(self.path("one.npz")), command)
        return paths

    def cloud(self, name, count, seed, dtype=np.float32):
        rng = np.random.default_rng(seed)
        points = rng.random((count, 3)) ** 2
        return self.npy(name, points, dtype)

    def test_bytes_of_one_search(self):
        for scene in ("lattice", "clusters", "spray", "far", "coincident", "outlier", "dam_break"):
            self.same(7, "search", self.scene(scene, 4000))
        # Points far out of their voxels, in leaves that seem far; NaN; one of two grids.
        for radius in ("0.5", "3", "40"):
            self.same(5, "search", self.fixture("affine.vdb"), "-r", radius, "--lists", "distance")
        self.same(3, "search", self.fixture("nonfinite.vdb"), "-r", "2")
        self.same(3, "search", self.fixture("two_grids.vdb"), "-g", "first", "-r", "2")
        self.same(2, "search", self.fixture("empty.vdb"), "-r", "2")
        path = self.scene("block", 5000)
        for tiles in (1, 2, 40):
            self.same(tiles, "search", path)

    def test_bytes_with_flags(self):
        path = self.scene("clusters", 3000)
        for flags in (["--lists", "distance"], ["--order", "distance"], ["--order", "distance", "--lists", "distance"], ["--nearest", "5"],
                      ["--include-self"], ["--encoding", "mask"], ["-r", "0.001"], ["-r", "5"], ["--cell-size", "1"], ["-T", "1"],
                      ["--host-memory", "1G", "--lists", "distance", "--order", "distance", "--nearest", "9"]):
            self.same(4, "search", path, *flags)

    def test_bytes_of_arrays(self):
        for k, dtype in enumerate((np.float32, np.float64)):
            path = self.cloud(f"a{k}.npy", 3000, k, dtype)
            self.same(6, "search", path, "-r", "0.05", "--lists", "distance")
        queries = self.cloud("q.npy", 500, 3)
        self.same(3, "search", path, "-r", "0.1", "--queries", queries)
        np.save(self.path("radii.npy"), np.random.default_rng(4).random(3000) / 10)
        for mode in ("gather", "scatter", "symmetric"):
            self.same(5, "search", path, "--radius-file", self.path("radii.npy"), "--radius-mode", mode)
        bad = np.load(path)
        bad[[3, 70, 800], [0, 1, 2]] = [np.nan, np.inf, -np.inf]
        self.same(4, "search", self.npy("bad.npy", bad, np.float64), "-r", "0.08")
        self.same(3, "search", self.npy("none.npy", np.zeros((0, 3))), "-r", "1")
        # Fewer leaves than tiles: parts without rows.
        self.same(9, "search", self.npy("far.npy", [[1e30, 0, 0], [-1e30, 0, 0], [1e30, 0, 0]], np.float64), "-r", "1e25")

    def test_what_a_part_is(self):
        path = self.scene("block", 3000)
        paths = self.parts(3, "search", path, "--lists", "distance")
        one = self.path("one.npz")
        self.succeeds("search", path, "--lists", "distance", "-o", one, "-q")
        whole = scipy.sparse.load_npz(one)
        seen, origins = [], []
        for k, part in enumerate(paths, 1):
            rows = scipy.sparse.load_npz(part)
            members = np.load(part)
            self.assertEqual(members.files, ["indptr", "indices", "data", "shape", "format", "rows", "part"])
            self.assertEqual((members["rows"].dtype, rows.shape), (np.int64, (len(members["rows"]), 3000)))
            self.assertTrue((np.diff(members["rows"]) > 0).all())
            self.assertEqual((whole[members["rows"]] != rows).nnz, 0)
            self.assertEqual(list(members["part"][[0, 1, 4]]), [k, 3, 3000])
            seen += list(members["rows"])
            origins.append(tuple(members["part"][1:]))
            with zipfile.ZipFile(part) as file:
                self.assertIsNone(file.testzip())
        self.assertEqual(sorted(seen), list(range(3000)))
        self.assertEqual(len(set(origins)), 1)
        # The same bytes for any number of threads, and cuts that are those of the plan.
        for threads in (1, 3):
            self.succeeds("search", path, "--lists", "distance", "--tile", "2/3", "-o", self.path("again.npz"), "-q", "-f", "-T", threads)
            self.assertEqual(self.bytes(self.path("again.npz")), self.bytes(paths[1]))
        report = self.report("search", path, "--tile", "2/3")
        tiles = self.report("plan", path, "--tiles", "3")["tiles"]
        self.assertEqual(report["tile"], {"tile": 2, "tiles": 3, "rows": tiles[1]["particles"]})
        pairs = sum(self.report("search", path, "--tile", f"{k}/3")["result"]["pairs"] for k in (1, 2, 3))
        self.assertEqual(pairs, whole.nnz)

    def test_a_tile_is_read_alone(self):
        """Of a .vdb, in memory for what is around it; where other points are asked for, all are read. The same bytes either way."""
        path = self.scene("block", 2000000)
        whole = self.report("search", path, "--encoding", "index")
        part = self.report("search", path, "--tile", "1/16", "-o", self.path("alone.npz"))
        self.assertEqual(part["input"]["points"], 2000000)
        self.assertLess(part["memory"]["peak_rss_bytes"], whole["memory"]["peak_rss_bytes"] / 2)
        self.assertLess(part["memory"]["list_bytes"], whole["memory"]["list_bytes"] / 8)
        self.succeeds("search", path, "--tile", "1/16", "--nonfinite", "fail", "-o", self.path("all.npz"), "-q")
        self.assertEqual(self.bytes(self.path("alone.npz")), self.bytes(self.path("all.npz")))

    def test_equal_searches_go_together(self):
        """However their flags are written."""
        path = self.scene("block", 2000)
        radius = repr(self.report("info", path)["suggested_radius"])
        command = ["search", path, "--nearest"]
        self.succeeds(*command, "5", "--tile", "1/3", "-o", self.path("p1.npz"), "-q")
        self.succeeds(*command, "05", "--tile", "2/3", "-o", self.path("p2.npz"), "-q", "-g", "points", "-r", radius)
        self.succeeds(*command, "5", "--tile", "3/3", "-o", self.path("p3.npz"), "-q", "-T", "1", "--nonfinite", "fail")
        self.succeeds("merge", *[self.path(f"p{k}.npz") for k in (3, 1, 2)], "-o", self.path("all.npz"), "-q")
        self.succeeds(*command, "5", "-o", self.path("one.npz"), "-q")
        self.assertEqual(self.bytes(self.path("all.npz")), self.bytes(self.path("one.npz")))

    def test_many_parts(self):
        """More than files may be open, until the program asks for more."""
        import resource
        path = self.scene("spray", 3000)
        paths = self.parts(80, "search", path)
        hard = resource.getrlimit(resource.RLIMIT_NOFILE)[1]
        self.succeeds("merge", *paths, "-o", self.path("all.npz"), "-q",
                      preexec_fn=lambda: resource.setrlimit(resource.RLIMIT_NOFILE, (40, hard)))
        self.fails(3, "merge", *paths, "-o", self.path("none.npz"), says="ulimit",
                   preexec_fn=lambda: resource.setrlimit(resource.RLIMIT_NOFILE, (40, 40)))

    def test_plan(self):
        for path, flags in ((self.scene("spray", 20000), []), (self.npy("c.npy", np.random.default_rng(5).random((20000, 3))), ["-r", "0.02"])):
            report = self.report("plan", path, *flags, "--tiles", "8")
            tiles = report["tiles"]
            self.assertEqual([tile["tile"] for tile in tiles], list(range(1, 9)))
            self.assertEqual([tile["first_leaf"] for tile in tiles[1:]], [tile["end_leaf"] for tile in tiles[:-1]])
            self.assertEqual(sum(tile["particles"] for tile in tiles), 20000)
            for tile in tiles:
                self.assertGreater(tile["particles"], 500)
                self.assertGreater(tile["halo_particles"], 0)
                self.assertLessEqual(tile["halo_particles"] + tile["particles"], 20000)
                self.assertGreater(tile["bytes"], 0)
            self.assertEqual(self.report("plan", path, *flags, "--tiles", "8", "-T", "1")["tiles"], tiles)
        # All that may be near is in the halo: rows of a tile hold numbers of at most so many others.
        for k, tile in enumerate(tiles, 1):
            self.succeeds("search", path, *flags, "--tile", f"{k}/8", "-o", self.path("p.npz"), "-q", "-f")
            members = np.load(self.path("p.npz"))
            others = np.setdiff1d(members["indices"], members["rows"])
            self.assertLessEqual(len(others), tile["halo_particles"])

    def test_refused(self):
        path = self.scene("block", 1000)
        search = ["search", path, "-o", self.path("part.npz")]
        for tile in ("0/3", "4/3", "1/0", "1", "/", "1/", "/3", "a/b", "1/2/3", "-1/3", "1/100001", "1.5/2"):
            self.fails(2, *search, "--tile", tile, says="--tile")
        self.fails(2, *search, "--tile", "1/2", "-o", self.path("other.npz"), says="one part")
        self.fails(2, "search", path, "-o", self.path("x.vdb"), "--tile", "1/2", says="--tile")
        self.fails(2, *search, "--tile", "1/2", "--attributes-output", self.path("x.npz"), says="--tile")
        self.fails(2, *search, "--tile", "1/2", "--attributes", "cluster")
        self.fails(2, *search, "--tile", "1/2", "--device", "sim", says="--device")
        for tiles in ("0", "x", "-1", "100001"):
            self.fails(2, "plan", path, "--tiles", tiles, says="--tiles")
        self.fails(2, "merge", path, "-o", self.path("x.vdb"), says=".npz")
        self.fails(2, "merge", path, "-o", path, says=path)
        self.fails(2, "merge", "-o", self.path("x.npz"))

    def test_parts_that_do_not_go_together(self):
        path = self.scene("block", 2000)
        a = self.parts(3, "search", path)
        out = self.path("all.npz")
        self.fails(3, "merge", a[0], a[2], "-o", out, says=["tile 2 of 3", "missing"])
        self.fails(3, "merge", a[1], "-o", out, says=["tile 1 of 3", "missing"])
        self.fails(3, "merge", *a, a[1], "-o", out, says=[a[1], "given twice", "once"])
        shutil.copy(a[0], self.path("copy.npz"))
        self.fails(3, "merge", a[0], a[1], self.path("copy.npz"), "-o", out, says=[self.path("copy.npz"), a[0]])
        for name, command in (("radius", ["search", path, "-r", "0.15"]), ("flags", ["search", path, "--order", "distance"]),
                              ("points", ["search", self.scene("clusters", 2000), "-r", "0.2"])):
            other = self.path(f"{name}.npz")
            self.succeeds(*command, "--tile", "2/3", "-o", other, "-q")
            self.fails(3, "merge", a[0], other, a[2], "-o", out, says=[other, "another search", name])
        other = self.path("cut.npz")
        self.succeeds("search", path, "--tile", "2/4", "-o", other, "-q")
        self.fails(3, "merge", a[0], other, a[2], "-o", out, says=[other, "another number of tiles"])
        self.fails(3, "merge", a[0], self.path("gone.npz"), "-o", out, says=self.path("gone.npz"))
        self.assertFalse(os.path.exists(out))

    def test_damaged_parts(self):
        path = self.scene("block", 500)
        a = self.parts(2, "search", path, "--lists", "distance")
        out = self.path("all.npz")
        whole = self.bytes(a[1])
        lists = self.path("lists.npz")
        self.succeeds("search", path, "-o", lists, "-q")
        np.savez(self.path("numpy.npz"), rows=np.arange(3), part=np.arange(5))
        for other in (lists, self.path("numpy.npz"), path, self.text("empty.npz", ""), self.text("text.npz", "x" * 5000)):
            self.fails(3, "merge", a[0], other, "-o", out, says=[other, "no part"])
        bad = self.path("bad.npz")
        for length in (0, 1, 21, 22, 100, len(whole) // 2, len(whole) - 1):
            self.text("bad.npz", whole[:length])
            self.fails(3, "merge", a[0], bad, "-o", out, says=bad)
        self.text("bad.npz", whole + b"\0")
        self.fails(3, "merge", a[0], bad, "-o", out, says=bad)
        rng = np.random.default_rng(1)
        for place in [*rng.integers(0, len(whole), 60), *range(len(whole) - 60, len(whole))]:
            damaged = bytearray(whole)
            damaged[place] ^= 1 << int(rng.integers(8))
            self.text("bad.npz", bytes(damaged))
            self.fails(3, "merge", a[0], bad, "-o", out, says=bad)

    def test_full_disk_and_report(self):
        a = self.parts(3, "search", self.scene("block", 3000))
        self.fails(6, "merge", *a, "-o", self.path("all.npz"), preexec_fn=cli_case.limit_file_size(10000))
        report = self.report("merge", *a, "-o", self.path("all.npz"))
        self.assertEqual((report["command"], report["parts"], report["rows"], report["columns"]), ("merge", 3, 3000, 3000))
        self.assertEqual(report["pairs"], scipy.sparse.load_npz(self.path("all.npz")).nnz)
        self.fails(2, "merge", *a, "-o", self.path("all.npz"), says="exists")
        self.succeeds("merge", *a, "-o", self.path("all.npz"), "-f")
        self.succeeds("verify", self.path("block.vdb"), self.path("all.npz"), "-q")

"""Bad and unusual input: the exit code, a clear error, nothing half-written; or a right answer."""
import os
import re
import struct
import time

import numpy as np

from cli_case import CliCase


class BadFiles(CliCase):
    def rejects(self, path, *says, code=3, radius="1"):
        """Refused by search with and without output, and the error names the file."""
        name = os.path.basename(path)
        self.fails(code, "search", path, "-r", radius, "-o", self.path("out.npz"), says=[name, *says])
        self.fails(code, "search", path, "-r", radius, "--json", "-", says=[name, *says])

    def test_missing_and_unknown(self):
        self.rejects(self.path("missing.vdb"))
        self.rejects(self.path("missing.npy"))
        self.rejects(self.text("points.obj", "v 0 0 0\n"), code=2)
        self.rejects(self.text("points", "0 0 0\n"), code=2)
        os.mkdir(self.path("folder.vdb"))
        self.rejects(self.path("folder.vdb"), "is a folder")
        os.mkdir(self.path("folder"))
        self.rejects(self.path("folder"), "is a folder")
        for extension in (".vdb", ".npy", ".ply", ".xyz"):
            os.symlink("/proc/self/status", self.path("no_size" + extension))
            self.rejects(self.path("no_size" + extension), "no size", "copy")

    def test_not_a_vdb(self):
        self.rejects(self.text("empty.vdb", b""))
        self.rejects(self.text("text.vdb", "this is not a volume " * 100))
        self.rejects(self.fixture("no_points.vdb"))

    def test_pipes_and_devices(self):
        for name in ("pipe.vdb", "pipe.xyz"):
            os.mkfifo(self.path(name))
            self.rejects(self.path(name), "a pipe", "to a file first")
        for name in ("device.vdb", "device.npy"):
            os.symlink("/dev/zero", self.path(name))
            self.rejects(self.path(name), "a device", "to a file first")

    def test_vdb_truncated_anywhere(self):
        path = self.scene("block", 2000)
        with open(path, "rb") as file:
            data = file.read()
        cuts = {len(data) - n for n in (1, 2, 7, 8, 9, 16, 100)} | {1, 4, 8, 20, 21, 57, 100}
        cuts |= set(np.linspace(0, len(data) - 1, 50).astype(int).tolist())
        for size in sorted(cuts):
            with self.subTest(size=size, whole=len(data)):
                cut = self.text("cut.vdb", data[:size])
                self.fails(3, "search", cut, "-r", "0.1", "-o", self.path("out.npz"), says="cut.vdb")

    def test_vdb_of_other_versions(self):
        with open(self.scene(), "rb") as file:
            data = file.read()
        self.assertIn(data[8], (224, 225))

        def of_version(version):
            return self.text("version.vdb", data[:8] + struct.pack("<I", version) + data[12:])

        for version in (222, 223):  # a volume: point grids came later
            self.rejects(of_version(version), f"version {version}, which has no point grids")
        for version in (226, 300):
            self.rejects(of_version(version), f"version {version}", "224 to 225", "write the file again")

    def test_vdb_with_bytes_behind_its_grids(self):
        with open(self.scene(), "rb") as file:
            self.rejects(self.text("more.vdb", file.read() + b"\0\0\0"), "but 3 bytes follow")

    def test_vdb_whose_tree_has_lost_its_root(self):
        # One bit: the root node has no child any more. OpenVDB reads that as a grid without points.
        with open(self.scene(), "rb") as file:
            data = bytearray(file.read())
        root = struct.pack("<4I", 1, 0, 0, 1)  # a buffer, background, tiles, children
        self.assertEqual(data.count(root), 1)
        data[data.index(root) + 12] = 0
        self.rejects(self.text("rootless.vdb", bytes(data)), "damaged: grid 'points': expected the end of the grid, which", "write")

    def test_unsupported_grids(self):
        self.rejects(self.fixture("frustum.vdb"), "points")
        self.rejects(self.fixture("p_vec3d.vdb"), "vec3d")
        self.rejects(self.fixture("p_uvec.vdb"), "uvec")
        self.rejects(self.fixture("p_ufxpt16.vdb"), "ufxpt16")
        self.rejects(self.fixture("p_missing.vdb"), "P")
        self.rejects(self.fixture("bad_offsets.vdb"))

    def test_singular_transform(self):
        with open(self.fixture("scale_to_patch.vdb"), "rb") as file:
            data = file.read()
        scale = struct.pack("<d", 0.7310585786300049)
        self.assertGreaterEqual(data.count(scale), 1)
        self.assertEqual(self.succeeds("search", self.text("good.vdb", data), "-r", "0.01", "-q").code, 0)
        self.rejects(self.text("singular.vdb", data.replace(scale, struct.pack("<d", 0))))

    def test_several_point_grids(self):
        path = self.fixture("two_grids.vdb")
        self.rejects(path, "first", "second", "--grid", code=2)
        self.fails(2, "search", path, "-r", "1", "-g", "third", says=["third", "first", "second"])
        self.assertEqual(self.report("search", path, "-r", "1", "-g", "first")["input"]["points"], 54)
        self.assertEqual(self.report("info", path, "-g", "second")["points"], 250)

    def test_npy(self):
        points = np.arange(12, dtype=np.float32).reshape(4, 3)
        np.save(self.path("good.npy"), points)
        self.assertEqual(self.report("info", self.path("good.npy"))["points"], 4)
        bad = {"wide": np.zeros((4, 4), np.float32), "flat": np.zeros(12, np.float32),
               "deep": np.zeros((4, 3, 1), np.float64), "transposed": np.zeros((3, 4), np.float32)}
        for name, array in bad.items():
            np.save(self.path(name + ".npy"), array)
            with self.subTest(name):
                self.rejects(self.path(name + ".npy"))
        with open(self.path("good.npy"), "rb") as file:
            data = file.read()
        for size in (0, 5, 9, 10, 60, 127, 128, len(data) - 1):
            with self.subTest(size=size):
                self.rejects(self.text("cut.npy", data[:size]))

    def test_npy_versions(self):
        for version in ((1, 0), (2, 0), (3, 0)):
            with open(self.path("v.npy"), "wb") as file:
                np.lib.format.write_array(file, np.zeros((5, 3)), version=version)
            self.assertEqual(self.report("search", self.path("v.npy"), "-r", "1")["result"]["pairs"], 20)

    def test_ply(self):
        header = "ply\nformat ascii 1.0\nelement vertex {}\nproperty float x\nproperty float y\nproperty float z\n" \
                 "end_header\n"
        body = "0 0 0\n1 0 0\n5 0 0\n"
        good = self.text("good.ply", header.format(3) + body)
        self.assertEqual(self.report("search", good, "-r", "1")["result"]["pairs"], 2)
        for count in ("100", "99999999999999", "-1", "many"):
            self.rejects(self.text("lies.ply", header.format(count) + body))
        self.rejects(self.text("noz.ply", header.format(3).replace("property float z\n", "") + body))
        integers = self.text("intx.ply", header.format(3).replace("float x", "int x") + body)
        self.assertEqual(self.report("search", integers, "-r", "1")["result"]["pairs"], 2)
        self.rejects(self.text("listx.ply", header.format(3).replace("float x", "list uchar float x") + body))
        self.rejects(self.text("noend.ply", header.format(3).replace("end_header\n", "")))
        self.rejects(self.text("words.ply", header.format(3) + "0 0 zero\n1 0 0\n5 0 0\n"))
        self.rejects(self.text("notply.ply", "solid\n"))
        binary = header.format(3).replace("ascii", "binary_little_endian").encode()
        values = np.array([0, 0, 0, 1, 0, 0, 5, 0, 0])
        self.assertEqual(self.report("search", self.text("le.ply", binary + values.astype("<f4").tobytes()),
                                     "-r", "1")["result"]["pairs"], 2)
        self.assertEqual(self.report("search", self.text("be.ply", binary.replace(b"little", b"big") +
                                                         values.astype(">f4").tobytes()),
                                     "-r", "1")["result"]["pairs"], 2)
        self.rejects(self.text("short.ply", binary + values.astype("<f4").tobytes()[:-1]))

    def test_xyz(self):
        good = self.text("good.xyz", "# a comment\n0 0 0\n1 0 0 # another\n\n5 0 0\n")
        self.assertEqual(self.report("search", good, "-r", "1")["result"]["pairs"], 2)
        self.rejects(self.text("count.xyz", "4\n0 0 0\n1 0 0\n5 0 0\n"), "counts 4 points, and 3 rows follow")
        self.rejects(self.text("wide.xyz", "0 0 0\n1 0 0 255 0 0\n"), "line 2 (byte 6)", "has 6 columns")
        self.rejects(self.text("words.xyz", "0 0 0\nC 1 0\n"))
        self.rejects(self.text("two.xyz", "0 0 0\n1 0\n"))


class OpenVdb13(CliCase):
    """Files that OpenVDB 13.0.1 wrote: file version 225, whatever OpenVDB is linked here."""

    def test_read_and_written(self):
        for name, points, pairs, checksum in (("openvdb13_dam_break_3000.vdb", 3000, 70558, "f8698556475faefd"),
                                              ("openvdb13_spray_fx16.vdb", 2000, 47236, "1176a6a9a05023a9")):
            with self.subTest(name):
                path, lists, out = self.data(name), self.path(name + ".npz"), self.path("out_" + name)
                done = self.succeeds("info", path)
                self.assertIn(f"{points}, 0 not finite", done.out)
                self.assertEqual(done.err, "")  # OpenVDB 10 to 12 warn of what is newer
                done = self.succeeds("search", path, "--checksum", "-o", lists, "-o", out)
                self.assertRegex(done.err, "^vdb_nns: [^\n]* suggests the radius 0.2\n$")
                for searched in (path, out):
                    result = self.report("search", searched, "--checksum")["result"]
                    self.assertEqual((result["pairs"], result["checksum"]), (pairs, checksum))
                self.succeeds("verify", path, lists)
                attributes = self.report("info", out)["attributes"]
                self.assertEqual([a["name"] for a in attributes][-1], "nns_count")


class Extremes(CliCase):
    def test_radius_larger_than_the_domain(self):
        report = self.report("search", self.scene(), "-r", "1e6")
        self.assertEqual(report["result"]["pairs"], 2000 * 1999)

    def test_radius_tiny(self):
        self.assertEqual(self.report("search", self.scene(), "-r", "1e-7")["result"]["pairs"], 0)

    def test_coordinates_past_the_limit(self):
        path = self.npy("far.npy", [[0, 0, 0], [1e9, 0, 0]])
        self.fails(3, "search", path, "-r", "1e-3", says=["far.npy", "radius"])
        self.assertEqual(self.report("search", path, "-r", "1")["result"]["pairs"], 0)

    def check_numbers(self, message, budget, lists):
        """Bytes needed: more than the budget, no more than the lists. Bytes allowed: the rest of the budget, less what
        the program uses by itself and a reserve, some 45 and 35 MB."""
        needed, allowed = (int(number) for number in re.findall(r"\b([0-9]+) bytes", message)[:2])
        self.assertTrue(budget < needed <= 1.1 * lists, message)
        self.assertTrue(budget - 120 * 10 ** 6 < allowed < budget - 30 * 10 ** 6, message)

    def test_lists_that_cannot_fit(self):
        path = self.npy("dense.npy", np.random.default_rng(1).random((30000, 3)))
        done = self.fails(4, "search", path, "-r", "5", "--host-memory", "200MB", "-T", "2", "--encoding", "index",
                          says=["dense.npy", "index lists", "--host-memory"])
        self.check_numbers(done.err, 200 * 10 ** 6, 30000 * 29999 * 4)
        # Masks take a bit where indices take 4 bytes; they do not fit either.
        done = self.fails(4, "search", path, "-r", "5", "--host-memory", "100MB", "-T", "2", "--checksum", "-q",
                          says=["dense.npy", "mask lists", "--host-memory"])
        self.check_numbers(done.err, 100 * 10 ** 6, 30000 * 30000 / 8 + 30000 * 4)

    def test_grid_that_cannot_fit(self):
        self.fails(4, "search", self.scene(), "--host-memory", "10K", says="--host-memory")

    def test_nothing_one_and_tiles(self):
        for path, points in ((self.fixture("empty.vdb"), 0), (self.fixture("one.vdb"), 1),
                             (self.fixture("tiles.vdb"), 0), (self.npy("empty.npy", np.zeros((0, 3))), 0),
                             (self.npy("one.npy", [[1, 2, 3]]), 1), (self.text("empty.xyz", ""), 0)):
            with self.subTest(path):
                out = self.path("out.npz")
                report = self.report("search", path, "-r", "1", "-o", out, "-f")
                self.assertEqual(report["input"]["points"], points)
                self.assertEqual(report["result"], {"pairs": 0, "min": 0, "mean": 0, "max": 0, "isolated": points,
                                                    "shortened": 0, "bad_radii": 0, "checksum": "0" * 16})
                self.assertEqual(int(np.load(out)["shape"][0]), points)
                self.assertEqual(self.report("info", path)["points"], points)

    def test_all_coincident(self):
        path = self.scene("coincident", 100000, "--fraction", "1")
        report = self.report("search", path, "-r", "0.1")
        self.assertEqual(report["result"]["pairs"], 100000 * 99999)
        self.assertEqual((report["result"]["min"], report["result"]["max"]), (99999, 99999))
        done = self.fails(4, "search", path, "-r", "0.1", "--encoding", "index", "--host-memory", "1G", "-T", "2",
                          says=["coincident.vdb", "--host-memory"])
        self.check_numbers(done.err, 1 << 30, 100000 * 99999 * 4)

    def test_nonfinite(self):
        points = np.zeros((5, 3))
        points[1, 0], points[2, 1], points[3, 2] = np.nan, np.inf, -np.inf
        for path, count, spoilt in ((self.npy("bad.npy", points), 5, 3), (self.fixture("nonfinite.vdb"), 128, 3)):
            report = self.report("search", path, "-r", "0.5", "-o", self.path("x.npz"), "-f")
            self.assertEqual((report["input"]["points"], report["input"]["nonfinite"]), (count, spoilt))
            self.assertLessEqual(report["result"]["isolated"], count - spoilt)  # of the finite ones
            self.fails(1, "search", path, "-r", "0.5", "--nonfinite", "fail", "-o", self.path("y.npz"),
                       says=[os.path.basename(path), f"{spoilt} of {count}"])
            self.assertEqual(self.report("info", path)["nonfinite"], spoilt)
        self.assertEqual(self.report("search", self.path("bad.npy"), "-r", "0.5")["result"]["pairs"], 2)

    def test_outlier_costs_nothing(self):
        near = self.scene("outlier", 50000, "--distance", "1e3")
        far = self.path("far.vdb")
        self.succeeds("scene", "outlier", "-n", "50000", "--distance", "1e9", "-o", far)
        start = time.monotonic()
        reports = [self.report("search", path) for path in (near, far)]
        self.assertLess(time.monotonic() - start, 30)
        self.assertEqual(reports[0]["result"]["pairs"], reports[1]["result"]["pairs"])
        peaks = [report["memory"]["peak_rss_bytes"] for report in reports]
        self.assertLess(peaks[1], peaks[0] + (64 << 20))

"""The .npz lists: what SciPy reads is what SciPy finds, byte by byte the same every time."""
import struct
import zipfile

import numpy as np
import scipy.sparse
from scipy.spatial import cKDTree

from cli_case import CliCase


def members(path):
    """Name, dtype, shape, offset of the data in the file, and the zip entry of every array."""
    found = []
    with open(path, "rb") as file, zipfile.ZipFile(path) as archive:
        for entry in archive.infolist():
            file.seek(entry.header_offset + 26)
            name_size, extra_size = struct.unpack("<HH", file.read(4))
            file.seek(entry.header_offset + 30 + name_size + extra_size)
            version = np.lib.format.read_magic(file)
            read = np.lib.format.read_array_header_1_0 if version == (1, 0) else np.lib.format.read_array_header_2_0
            shape, _, dtype = read(file)
            found.append((entry.filename, dtype, shape, file.tell(), entry))
    return found


class Lists(CliCase):
    def expected(self, positions, radius):
        pairs = cKDTree(positions).query_pairs(radius, output_type="ndarray")
        both = np.concatenate([pairs, pairs[:, ::-1]])
        return both[np.lexsort((both[:, 1], both[:, 0]))]

    def check(self, path, positions, radius, *more):
        out = self.path("lists.npz")
        report = self.report("search", path, "-r", repr(radius), "-o", out, "-f", *more)
        matrix = scipy.sparse.load_npz(out)
        expected = self.expected(positions, radius)
        self.assertEqual(report["result"]["pairs"], len(expected))
        self.assertEqual(matrix.shape, (len(positions), len(positions)))
        rows = np.repeat(np.arange(len(positions)), np.diff(matrix.indptr))
        np.testing.assert_array_equal(rows, expected[:, 0])
        np.testing.assert_array_equal(matrix.indices, expected[:, 1])
        counts = np.diff(matrix.indptr)
        self.assertEqual([report["result"][key] for key in ("min", "max", "isolated")],
                         [counts.min(), counts.max(), (counts == 0).sum()])
        self.assertAlmostEqual(report["result"]["mean"], counts.mean())
        return matrix

    def test_arrays_of_floats_and_doubles(self):
        for dtype in (np.float32, np.float64):
            positions = np.random.default_rng(7).random((3000, 3)).astype(dtype)
            path = self.npy("cloud.npy", positions, dtype)
            for reach in ("1", "0.5", "0.333"):
                matrix = self.check(path, positions.astype(np.float64), 0.1, "--cell-size", reach)
                self.assertEqual(matrix.data.dtype, np.int8)
                self.assertTrue((matrix.data == 1).all())

    def test_distances(self):
        positions = np.random.default_rng(8).random((2000, 3)).astype(np.float32)
        matrix = self.check(self.npy("cloud.npy", positions), positions.astype(np.float64), 0.12,
                            "--lists", "distance")
        rows = np.repeat(np.arange(2000), np.diff(matrix.indptr))
        delta = positions[matrix.indices].astype(np.float64) - positions[rows].astype(np.float64)
        x, y, z = delta.T
        self.assertEqual(matrix.data.dtype, np.float32)
        np.testing.assert_array_equal(matrix.data, np.sqrt(x * x + y * y + z * z).astype(np.float32))

    def test_grid_with_any_affine_map_and_points_out_of_their_voxels(self):
        positions = np.fromfile(self.fixture("affine.f64")).reshape(-1, 3)
        self.assertGreater(len(positions), 400)
        self.check(self.fixture("affine.vdb"), positions, 1.3)

    def test_ties_are_neighbors(self):
        side = np.arange(8) * 0.125
        lattice = np.stack(np.meshgrid(side, side, side, indexing="ij"), -1).reshape(-1, 3)
        delta = np.rint((lattice[:, None] - lattice[None]) * 8).astype(int)
        exact = ((delta ** 2).sum(-1) <= 4).sum() - len(lattice)
        self.assertEqual(self.report("search", self.npy("lattice.npy", lattice), "-r", "0.25")["result"]["pairs"],
                         exact)

    def test_coincident_points_are_neighbors(self):
        path = self.npy("same.npy", [[1, 2, 3]] * 4 + [[9, 9, 9]])
        self.succeeds("search", path, "-r", "0.5", "-o", self.path("x.npz"), "-q")
        matrix = scipy.sparse.load_npz(self.path("x.npz"))
        self.assertEqual(matrix.toarray().tolist(), [[int(i != j and max(i, j) < 4) for j in range(5)]
                                                     for i in range(5)])


class Layout(CliCase):
    def test_layout(self):
        path, out = self.scene(), self.path("lists.npz")
        for values, dtype in (("connectivity", np.int8), ("distance", np.float32)):
            self.succeeds("search", path, "-o", out, "--lists", values, "-f", "-q")
            found = members(out)
            self.assertEqual([m[0] for m in found],
                             [n + ".npy" for n in ("indptr", "indices", "data", "shape", "format")])
            self.assertEqual([m[1] for m in found], [np.int64, np.int32, dtype, np.int64, np.dtype("S3")])
            self.assertEqual(found[4][2], ())
            with zipfile.ZipFile(out) as archive:
                self.assertIsNone(archive.testzip())
            for name, kind, shape, offset, entry in found:
                self.assertEqual(entry.compress_type, zipfile.ZIP_STORED)
                self.assertEqual(entry.date_time, (1980, 1, 1, 0, 0, 0))
                self.assertEqual(offset % 64, 0, name)
                mapped = np.memmap(out, kind, "r", offset, shape or (1,))
                np.testing.assert_array_equal(mapped, np.atleast_1d(np.load(out)[name[:-4]]))

    def test_same_bytes_every_time(self):
        path = self.scene("clusters", 3000)
        for values in ("connectivity", "distance"):
            files = set()
            for args in (["-T", "1"], ["-T", "2"], ["-T", "2"], ["--encoding", "mask"], ["--encoding", "index"],
                         ["--encoding", "mask", "--cell-size", "0.5", "-T", "1"], ["--cell-size", "0.333"],
                         ["--repeat", "3"]):
                self.succeeds("search", path, "-o", self.path("x.npz"), "--lists", values, "-f", "-q", *args)
                with open(self.path("x.npz"), "rb") as file:
                    files.add(file.read())
            self.assertEqual(len(files), 1)

"""Points from one format into another: read back by NumPy, by a reader of .ply written here, and by the program itself."""
import os
import signal
import subprocess
import time

import numpy as np

import cli_case
from cli_case import CliCase, limit_file_size

PLY_TYPES = {"float": "<f4", "double": "<f8", "int": "<i4", "uchar": "u1"}


def read_ply(path):
    """A binary little-endian .ply of one element without lists."""
    with open(path, "rb") as file:
        data = file.read()
    head, body = data.split(b"end_header\n", 1)
    lines = head.decode().splitlines()
    assert lines[:2] == ["ply", "format binary_little_endian 1.0"], lines
    assert lines[2].startswith("element vertex ")
    fields = [(line.split()[2], PLY_TYPES[line.split()[1]]) for line in lines[3:]]
    rows = np.frombuffer(body, dtype=np.dtype(fields))
    assert len(rows) == int(lines[2].split()[2])
    return rows


def write_ply(path, fields, rows, ascii=False):
    """`fields`: names and types of a .ply; `rows`: a value of each field."""
    head = f"ply\nformat {'ascii' if ascii else 'binary_little_endian'} 1.0\nelement vertex {len(rows)}\n"
    head += "".join(f"property {kind} {name}\n" for name, kind in fields) + "end_header\n"
    with open(path, "wb") as file:
        file.write(head.encode())
        if ascii:
            for row in rows:
                file.write((" ".join(str(value) for value in row) + "\n").encode())
        else:
            types = dict(PLY_TYPES, ushort="<u2", uint="<u4", char="i1")
            file.write(np.array([tuple(row) for row in rows], dtype=[(n, types[k]) for n, k in fields]).tobytes())
    return path


def cloud(count, dtype=np.float32, seed=3):
    return np.random.default_rng(seed).uniform(-4, 4, (count, 3)).astype(dtype)


class RoundTrips(CliCase):
    def arrays(self, path):
        """The arrays of what `path` becomes as an .npz."""
        out = self.path("arrays.npz")
        self.succeeds("convert", path, "-o", out, "-f", "-q")
        with np.load(out) as file:
            return {name: file[name] for name in file.files}

    def test_array_to_grid_and_back(self):
        for dtype in (np.float32, np.float64):
            with self.subTest(dtype=dtype):
                positions = cloud(5000, dtype)
                path, grid = self.npy("x.npy", positions, dtype), self.path("x.vdb")
                report = self.report("convert", path, "-o", grid, "-f")
                output = report["output"]
                self.assertEqual((report["command"], output["format"], output["points"], output["skipped"]),
                                 ("convert", "vdb", 5000, 0))
                self.assertEqual((output["id"], output["attributes"], output["groups"]), ("id", [], []))
                info = self.report("info", grid)
                self.assertEqual((info["grid"], info["codec"], info["points"]), ("points", "null", 5000))
                self.assertEqual(info["voxel_size"], [output["voxel_size"]] * 3)
                self.assertIn({"name": "id", "type": "int32", "codec": "null"}, info["attributes"])

                back = self.arrays(grid)
                self.assertEqual(sorted(back["id"]), list(range(5000)))
                error = np.linalg.norm(back["positions"] - positions[back["id"]].astype(np.float64), axis=1).max()
                self.assertGreater(output["largest_rounding"], 0)
                self.assertLessEqual(error, output["largest_rounding"] * 1.001)
                self.assertGreater(error, output["largest_rounding"] * 0.9)
                self.assertLess(error, output["voxel_size"] * 2.0**-24)

    def test_powers_of_two_round_no_float(self):
        positions = cloud(3000)
        done = self.succeeds("convert", self.npy("x.npy", positions), "-o", self.path("x.vdb"), "--voxel-size", "0.25")
        self.assertEqual(done.err, "")
        self.assertIn("none", done.out)
        back = self.arrays(self.path("x.vdb"))
        self.assertEqual(back["positions"].dtype, np.float32)
        np.testing.assert_array_equal(back["positions"], positions[back["id"]])
        # The same pairs then.
        for path in ("x.npy", "x.vdb"):
            self.succeeds("search", self.path(path), "-r", "0.5", "--lists", "distance", "-o", self.path(path + ".npz"), "-q")
        import scipy.sparse
        before = scipy.sparse.load_npz(self.path("x.npy.npz"))
        after = scipy.sparse.load_npz(self.path("x.vdb.npz"))
        order = np.argsort(back["id"])
        self.assertEqual((before != after[order][:, order]).nnz, 0)

    def test_default_voxels_hold_eight_points(self):
        self.npy("x.npy", cloud(20000))
        report = self.report("convert", self.path("x.npy"), "-o", self.path("x.vdb"))
        size = report["output"]["voxel_size"]
        voxels = np.unique(np.floor(cloud(20000).astype(float) / size + 0.5), axis=0)
        self.assertAlmostEqual(20000 / len(voxels), 8, delta=0.4)
        self.assertEqual(size, float(f"{size:.3g}"))
        done = self.succeeds("convert", self.path("x.npy"), "-o", self.path("x.vdb"), "-f")
        self.assertIn("8 points", done.out)
        self.assertIn("may be neighbors in one file", done.err)

    def test_properties_of_a_ply(self):
        fields = [("x", "float"), ("nx", "float"), ("y", "float"), ("z", "float"), ("mass", "double"), ("red", "uchar"),
                  ("label", "ushort"), ("big", "uint"), ("low", "char")]
        rng, count = np.random.default_rng(1), 700
        rows = [(*rng.uniform(-1, 1, 4).astype(np.float32), rng.uniform(), i % 256, i * 90, 4294967295 - i, -(i % 100))
                for i in range(count)]
        for ascii in (False, True):
            with self.subTest(ascii=ascii):
                source = write_ply(self.path("x.ply"), fields, rows, ascii)
                report = self.report("convert", source, "-o", self.path("x.vdb"), "-f")
                self.assertEqual(report["output"]["attributes"],
                                 [{"name": "nx", "type": "float"}, {"name": "mass", "type": "double"},
                                  {"name": "red", "type": "int32"}, {"name": "label", "type": "int32"},
                                  {"name": "big", "type": "int64"}, {"name": "low", "type": "int32"}])
                self.assertEqual(report["output"]["left_out"], [])
                self.succeeds("convert", self.path("x.vdb"), "-o", self.path("y.ply"), "-f", "-q")
                back = read_ply(self.path("y.ply"))
                self.assertEqual(sorted(back["id"]), list(range(count)))
                for k, (name, _) in enumerate(fields):
                    if name not in "xyz":
                        expected = np.array([rows[i][k] for i in back["id"]], dtype=back[name].dtype)
                        np.testing.assert_array_equal(back[name], expected, name)
                np.testing.assert_allclose(back["x"], [rows[i][0] for i in back["id"]], atol=1e-6)

    def test_attributes_and_groups_of_a_grid(self):
        source = self.fixture("named_values.vdb")
        report = self.report("convert", source, "-g", "points", "-o", self.path("x.ply"))
        # Its own id comes along: a .ply gets none of ours.
        self.assertEqual([a["name"] for a in report["output"]["attributes"]], ["pscale", "mass", "v", "id"])
        self.assertEqual((report["output"]["groups"], report["output"]["id"]), (["even", "third"], None))
        rows = read_ply(self.path("x.ply"))
        expected = np.fromfile(self.fixture("named_values_points.f64")).reshape(-1, 3)
        number = np.arange(len(expected))
        self.assertEqual(rows.dtype.names, ("x", "y", "z", "pscale", "mass", "v_x", "v_y", "v_z", "id", "even", "third"))
        np.testing.assert_array_equal(np.stack([rows[axis] for axis in "xyz"], 1), expected)
        np.testing.assert_array_equal(rows["pscale"], np.float32(0.05) * (1 + number % 7).astype(np.float32))
        np.testing.assert_array_equal(rows["mass"], 0.05 * (1 + number % 7))
        np.testing.assert_array_equal(rows["even"], number % 2 == 0)
        np.testing.assert_array_equal(rows["third"], number % 3 == 0)

        self.succeeds("convert", source, "-g", "points", "-o", self.path("x.npz"), "-q")
        with np.load(self.path("x.npz")) as file:
            self.assertEqual(file.files, ["positions", "pscale", "mass", "v", "id", "even", "third"])
            self.assertEqual((file["v"].shape, file["v"].dtype), ((len(expected), 3), np.float32))
            self.assertEqual(file["even"].dtype, np.bool_)
            np.testing.assert_array_equal(file["third"], number % 3 == 0)

        # Into another grid: the points in another order, each with its values.
        report = self.report("convert", source, "-g", "points", "-o", self.path("x.vdb"), "--voxel-size", "0.7")
        self.assertEqual([left["name"] for left in report["output"]["left_out"]], ["id"])
        self.succeeds("convert", self.path("x.vdb"), "-o", self.path("y.npz"), "-q")
        with np.load(self.path("y.npz")) as file:
            order = file["id"]
            self.assertFalse(np.array_equal(order, number))
            np.testing.assert_array_equal(file["mass"], 0.05 * (1 + order % 7))
            np.testing.assert_array_equal(file["even"], order % 2 == 0)
            np.testing.assert_allclose(file["positions"], expected[order], atol=1e-7)

    def test_arrays_of_an_npz(self):
        count = 300
        rng = np.random.default_rng(2)
        arrays = {"where": cloud(count, np.float64), "v": rng.normal(size=(count, 3)).astype(np.float32),
                  "half": rng.normal(size=count).astype(np.float16), "w": np.asfortranarray(rng.normal(size=(count, 3))),
                  "m": np.asfortranarray(rng.normal(size=(count, 3, 3)).astype(">f4")), "n": np.arange(count, dtype=">i2"),
                  "u": np.arange(count, dtype=np.uint64) + 2**62, "chosen": np.arange(count) % 5 == 0,
                  "column": np.arange(count, dtype=np.float64).reshape(-1, 1)}
        other = {"short": np.zeros(7), "text": np.array(["a"] * count), "cells": np.zeros((count, 3), np.int32),
                 "complex": np.zeros(count, complex), "wide": np.zeros((count, 4), np.float32)}
        for save in (np.savez, np.savez_compressed):
            save(self.path("x.npz"), **arrays, **other)
            args = ["convert", self.path("x.npz"), "--array", "where", "-f"]
            report = self.report(*args, "-o", self.path("y.npz"))
            self.assertEqual({left["name"] for left in report["output"]["left_out"]}, set(other))
            with np.load(self.path("y.npz")) as file:
                self.assertEqual(set(file.files), {"positions", *arrays} - {"where"})
                np.testing.assert_array_equal(file["positions"], arrays["where"])
                for name in set(arrays) - {"where", "column"}:
                    np.testing.assert_array_equal(file[name], arrays[name], name)
                np.testing.assert_array_equal(file["column"], arrays["column"][:, 0])
                kinds = {name: file[name].dtype.str for name in file.files}
            self.assertEqual(kinds, {"positions": "<f8", "v": "<f4", "half": "<f4", "w": "<f8", "m": "<f4", "n": "<i4",
                                     "u": "<i8", "chosen": "|b1", "column": "<f8"})
            self.succeeds(*args, "-o", self.path("y.vdb"), "-q")
            with np.load(self.converted(self.path("y.vdb"))) as file:
                for name in ("v", "w", "m", "n", "u", "chosen"):
                    np.testing.assert_array_equal(file[name], arrays[name][file["id"]], name)
        arrays["u"][5] = 2**63
        np.savez(self.path("x.npz"), **arrays)
        os.remove(self.path("y.npz"))
        self.fails(3, *args, "-o", self.path("y.npz"), says=["'u'", "2^63-1"])

    def converted(self, path):
        self.succeeds("convert", path, "-o", self.path("back.npz"), "-f", "-q")
        return self.path("back.npz")

    def test_every_pair_of_formats(self):
        positions = cloud(200)
        text = self.text("x.csv", "x,y,z\n" + "".join(f"{x!r},{y!r},{z!r}\n" for x, y, z in positions.tolist()))
        npy = self.npy("x.npy", positions)
        ply = write_ply(self.path("x.ply"), [(axis, "float") for axis in "xyz"], positions.tolist())
        np.savez(self.path("x.npz"), positions)
        for source in (text, npy, ply, self.path("x.npz")):
            for extension in ("npy", "npz", "ply", "vdb", "NPY"):
                out = self.path("out." + extension)
                self.succeeds("convert", source, "-o", out, "-f", "-q", "--voxel-size", "0.5"
                              ) if extension == "vdb" else self.succeeds("convert", source, "-o", out, "-f", "-q")
                if extension.lower() == "npy":
                    array = np.load(out)
                    self.assertEqual(array.dtype, np.float32)
                    np.testing.assert_array_equal(array, positions)
                elif extension == "ply":
                    rows = read_ply(out)
                    np.testing.assert_array_equal(np.stack([rows[axis] for axis in "xyz"], 1), positions)

    def test_array_named_positions(self):
        np.savez(self.path("x.npz"), mass=np.ones((50, 3)), positions=cloud(50))
        self.assertEqual(self.report("info", self.path("x.npz"))["taken"], "array 'positions'")
        self.succeeds("search", self.path("x.npz"), "-r", "1", "-o", self.path("lists.npz"), "-q")
        self.succeeds("verify", self.path("x.npz"), self.path("lists.npz"), "-r", "1")
        np.savez(self.path("x.npz"), mass=np.ones((50, 3)), places=cloud(50))
        self.fails(2, "info", self.path("x.npz"), says=["'mass', 'places'", "--array"])

    def test_progress(self):
        for source in (self.scene("block", 30000), self.fixture("named_values.vdb")):
            for out in ("x.ply", "x.vdb", "x.npz"):
                done = self.succeeds("convert", source, "-g", "points", "-o", self.path(out), "-f", "-q", "--progress", "always")
                shown = [int(line[9:-1]) for line in done.err.splitlines()]
                self.assertEqual((shown, shown[-1]), (sorted(set(shown)), 100), done.err)
                self.assertGreater(len(shown), 2)

    def test_scene_keeps_its_radius(self):
        scene = self.scene("block", 1000)
        self.succeeds("convert", scene, "-o", self.path("x.vdb"), "-q")
        self.assertEqual(self.report("info", scene)["suggested_radius"],
                         self.report("info", self.path("x.vdb"))["suggested_radius"])

    def test_nonfinite(self):
        positions = cloud(100, np.float64)
        positions[3, 1], positions[90] = np.nan, [np.inf, 0, 0]
        path = self.npy("x.npy", positions, np.float64)
        report = self.report("convert", path, "-o", self.path("x.vdb"))
        self.assertEqual((report["input"]["nonfinite"], report["output"]["points"], report["output"]["skipped"]), (2, 98, 2))
        with np.load(self.converted(self.path("x.vdb"))) as file:
            self.assertEqual(set(range(100)) - set(file["id"]), {3, 90})
        for name in ("x.ply", "y.npy", "x.npz"):
            report = self.report("convert", path, "-o", self.path(name))
            self.assertEqual((report["output"]["points"], report["output"]["skipped"]), (100, 0))
        np.testing.assert_array_equal(np.load(self.path("y.npy")), positions)
        self.assertIn("warning: 2 points", self.succeeds("convert", path, "-o", self.path("x.vdb"), "-f").err)
        for name in ("z.vdb", "z.npy"):
            self.fails(1, "convert", path, "-o", self.path(name), "--nonfinite", "fail", says=["2 of 100", "skip"])

    def test_empty(self):
        path = self.npy("x.npy", np.zeros((0, 3)))
        for name in ("y.vdb", "y.ply", "y.npz", "y.npy"):
            report = self.report("convert", path, "-o", self.path(name))
            self.assertEqual((report["output"]["points"], report["output"]["largest_rounding"]), (0, 0))
            self.assertEqual(self.report("info", self.path(name))["points"], 0)


class Refusals(CliCase):
    def test_keep(self):
        source = ["convert", self.fixture("named_values.vdb"), "-g", "points"]
        report = self.report(*source, "-o", self.path("x.npz"), "--keep", "third, mass")
        self.assertEqual(([a["name"] for a in report["output"]["attributes"]], report["output"]["groups"]),
                         (["mass"], ["third"]))
        report = self.report(*source, "-o", self.path("x.npz"), "-f", "--keep", "none")
        self.assertEqual((report["output"]["attributes"], report["output"]["groups"]), ([], []))
        self.fails(2, *source, "-o", self.path("y.npz"), "--keep", "pscal", says=["'pscal'", "did you mean 'pscale'?"])
        self.fails(2, *source, "-o", self.path("y.npz"), "--keep", "zzz", says=["'zzz'", "'pscale'", "'third'"])
        self.fails(2, *source, "-o", self.path("y.npz"), "--keep", "mass,,v", says="empty name")
        self.fails(2, *source, "-o", self.path("y.npz"), "--keep", "", says="--keep")
        self.fails(2, *source, "-o", self.path("y.npy"), "--keep", "mass", says=["'mass'", ".npz"])
        self.fails(2, *source, "-o", self.path("y.vdb"), "--keep", "id", says="'id'")
        self.fails(2, "convert", self.npy("x.npy", cloud(3)), "-o", self.path("y.npz"), "--keep", "mass", says="'mass'")

    def test_kinds_that_cannot_be_carried(self):
        path = self.text("x.ply", "ply\nformat ascii 1.0\nelement vertex 1\nproperty float x\nproperty float y\nproperty float z\n"
                                  "property list uchar int ring\nproperty float a-b\nend_header\n1 2 3 1 7 0.5\n")
        for name, left in (("x.vdb", ["ring", "a-b"]), ("x.npz", ["ring"])):
            done = self.succeeds("convert", path, "-o", self.path(name), "-f", "--voxel-size", "1"
                                 ) if name == "x.vdb" else self.succeeds("convert", path, "-o", self.path(name))
            report = self.report("convert", path, "-o", self.path(name), "-f")
            self.assertEqual([each["name"] for each in report["output"]["left_out"]], left)
            for each in left:
                self.assertIn(f"warning: left out: {each} ", done.err)
                self.assertRegex(done.out, f"left out +{each}")
        self.fails(3, "convert", path, "-o", self.path("y.npz"), "--keep", "ring", says=["'ring'", "list uchar int"])
        self.fails(2, "convert", path, "-o", self.path("y.vdb"), "--keep", "a-b", says="'a-b'")
        vtk = self.text("x.vtk", "# vtk DataFile Version 3.0\nx\nASCII\nDATASET POLYDATA\nPOINTS 1 float\n1 2 3\n"
                                 "POINT_DATA 1\nSCALARS mass float 1\nLOOKUP_TABLE default\n5\n")
        self.assertIn("left out: what the .vtk holds", self.succeeds("convert", vtk, "-o", self.path("v.ply")).err)
        self.assertEqual(self.succeeds("convert", vtk, "-o", self.path("v.ply"), "-f", "--keep", "none").err, "")

    def test_flags(self):
        path = self.npy("x.npy", cloud(10))
        self.fails(2, "convert", path, says="--output")
        for name in ("y.txt", "y", "y.vdb.gz", ".vdb"):
            self.fails(2, "convert", path, "-o", self.path(name), says=[name, ".vdb"])
        for value in ("0", "-1", "nan", "inf", "x", ""):
            self.fails(2, "convert", path, "-o", self.path("y.vdb"), "--voxel-size", value, says="--voxel-size")
        self.fails(2, "convert", path, "-o", self.path("y.ply"), "--voxel-size", "1", says="--voxel-size")
        self.fails(2, "convert", path, "-o", path, "-f", says="is an input")
        self.fails(2, "convert", path, "-o", self.path("y.npz"), "-g", "points", says="grid")
        self.fails(3, "convert", self.path("missing.npy"), "-o", self.path("y.npz"), says="missing.npy")
        self.fails(2, "convert", self.fixture("two_grids.vdb"), "-o", self.path("y.npz"), says=["'first'", "'second'"])
        self.fails(3, "convert", self.fixture("frustum.vdb"), "-o", self.path("y.npz"), says="not linear")

    def test_extent(self):
        path = self.npy("x.npy", [[0, 0, 0], [1e9, 0, 0]], np.float64)
        self.fails(3, "convert", path, "-o", self.path("y.vdb"), "--voxel-size", "0.1",
                   says=["1e+09", "2147479552", "0.46566"])
        self.succeeds("convert", path, "-o", self.path("y.vdb"), "--voxel-size", "0.46567", "-q")

    def test_existing_output(self):
        path, out = self.npy("x.npy", cloud(10)), self.text("y.vdb", "precious")
        self.fails(2, "convert", path, "-o", out, says=["y.vdb", "force"])
        self.assertEqual(self.bytes(out), b"precious")
        self.fails(2, "convert", self.path("missing.npy"), "-o", out, says="y.vdb")
        self.succeeds("convert", path, "-o", out, "-f", "-q")
        self.assertEqual(self.report("info", out)["points"], 10)

    def test_disk_full(self):
        path = self.npy("x.npy", cloud(50000))
        for name in ("y.vdb", "y.ply", "y.npz", "y.npy"):
            self.fails(6, "convert", path, "-o", self.path(name), says=name, preexec_fn=limit_file_size(100000))
        disk = self.path("disk")
        os.mkdir(disk)
        mount = ["mount", "-t", "tmpfs", "-o", "size=64k", "none", disk]
        if os.geteuid() != 0 or subprocess.run(mount, stderr=subprocess.DEVNULL).returncode != 0:
            self.skipTest("cannot mount a small tmpfs here; the size limit stands in for it")
        try:
            for name in ("y.vdb", "y.ply", "y.npz", "y.npy"):
                self.fails(6, "convert", path, "-o", os.path.join(disk, name), says=name)
                self.assertEqual(os.listdir(disk), [])
        finally:
            subprocess.run(["umount", disk], check=True)

    def test_same_bytes_for_any_threads(self):
        path = self.npy("x.npy", cloud(30000))
        for name in ("y.vdb", "y.ply", "y.npz"):
            found = set()
            for threads in (1, 2, 7):
                self.succeeds("convert", path, "-o", self.path(name), "-f", "-q", "-T", threads)
                data = self.bytes(self.path(name))
                found.add(data[:21] + data[57:] if name == "y.vdb" else data)
            self.assertEqual(len(found), 1, name)


class Interrupt(CliCase):
    def test_stopped_while_writing(self):
        path = self.npy("x.npy", cloud(3000000))
        for number, code in ((signal.SIGINT, 130), (signal.SIGTERM, 143)):
            before = sorted(os.listdir(self.folder))
            process = subprocess.Popen([cli_case.BINARY, "convert", path, "-o", self.path("y.vdb"), "-T", "1", "--progress",
                                        "always"], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
            self.addCleanup(process.kill)
            for line in process.stderr:
                if line.startswith("PROGRESS") and int(line[9:-2]) >= 31:
                    break
            start = time.monotonic()
            process.send_signal(number)
            out, err = process.communicate()
            self.assertLess(time.monotonic() - start, 10)
            self.assertEqual((process.returncode, out), (code, ""), err)
            self.assertEqual(sorted(os.listdir(self.folder)), before)

"""Files as other programs write them: each is read as what it is, or refused with the next step."""
import os
import zipfile

import numpy as np

from cli_case import CliCase

POINTS = np.random.default_rng(5).random((60, 3))


def pairs_within(points, radius):
    """Ordered pairs, by doubles: no pair of these points is near the radius."""
    distance = np.linalg.norm(points[:, None] - points[None], axis=2)
    return int(np.count_nonzero(distance <= radius)) - len(points)


class Formats(CliCase):
    def check(self, path, points, *args, radius=0.3):
        """All commands see these points; the report is returned."""
        points = np.asarray(points, dtype=np.float64)
        report = self.report("search", path, "-r", repr(radius), *args)
        self.assertEqual((report["input"]["points"], report["result"]["pairs"]), (len(points), pairs_within(points, radius)))
        info = self.report("info", path, *args)
        if len(points):
            np.testing.assert_array_equal(info["bbox"], [points.min(axis=0), points.max(axis=0)])
        lists = self.path("lists.npz")
        self.succeeds("search", path, "-r", repr(radius), "-o", lists, "-f", "-q", *args)
        self.succeeds("verify", path, lists, "-r", repr(radius), *args)
        self.assertEqual(info["taken"], report["input"]["taken"])
        return report

    def refuses(self, path, *says, args=(), code=3):
        self.fails(code, "search", path, "-r", "0.3", *args, says=[os.path.basename(path), *says])

    def test_given_cases(self):
        for name, radius in (("cr_only.xyz", 0.3), ("bom.xyz", 0.3), ("comma.xyz", 0.3), ("cc_header.xyz", 0.3), ("chem.xyz", 0.3),
                             ("vstack_T.npy", 0.3), ("structured.npy", 0.3)):
            with self.subTest(name):
                report = self.report("search", self.data(name), "-r", repr(radius))
                self.assertEqual((report["input"]["points"], report["result"]["pairs"]), (40, 124))
        report = self.report("search", self.data("msvc_nan_min.xyz"), "-r", "0.3")
        self.assertEqual((report["input"]["points"], report["input"]["nonfinite"], report["result"]["pairs"]), (3, 1, 0))
        self.refuses(self.data("kitti_n4.npy"), "--columns 0,1,2", "positions[:, :3]")
        report = self.report("search", self.data("kitti_n4.npy"), "-r", "0.3", "--columns", "0,1,2")
        self.assertEqual((report["input"]["points"], report["result"]["pairs"]), (40, 124))
        self.assertEqual(report["input"]["taken"], "columns 0, 1 and 2 of 4")

    def test_npy_of_any_number(self):
        for dtype in ("<f2", ">f2", "<f4", ">f4", "<f8", ">f8", "i1", "u1", "<i2", ">i2", "<u2", "<i4", ">u4", "<i8", ">u8"):
            for order in "CF":
                is_float = "f" in dtype
                points = np.asarray(POINTS if is_float else np.floor(POINTS * 100), dtype=dtype, order=order)
                np.save(self.path("a.npy"), points)
                with self.subTest(dtype=dtype, order=order):
                    self.check(self.path("a.npy"), points, radius=0.3 if is_float else 30)
        np.save(self.path("big.npy"), np.array([[0, 0, 2**53 + 1]]))
        self.refuses(self.path("big.npy"), "2^53", "point 0")

    def test_npy_records_and_wide_arrays(self):
        records = np.zeros(60, dtype=[("id", "i4"), ("x", "f4"), ("y", ">f8"), ("z", "f4"), ("v", "f4", (3,))])
        for k, axis in enumerate("xyz"):
            records[axis] = POINTS[:, k]
        np.save(self.path("r.npy"), records)
        taken = np.stack([records[axis] for axis in "xyz"], axis=1)
        self.assertEqual(self.check(self.path("r.npy"), taken)["input"]["taken"], "fields 'x', 'y' and 'z' of 5")
        wide = np.hstack([np.full((60, 1), 7), POINTS])
        np.save(self.path("w.npy"), wide)
        self.check(self.path("w.npy"), POINTS, "--columns", "1,2,3")
        self.check(self.path("w.npy"), POINTS[:, [2, 0, 1]], "--columns", "3,1,2")
        self.refuses(self.path("w.npy"), "column 4", args=("--columns", "1,2,4"), code=2)
        for name, array, says in (("flat", POINTS.ravel(), "reshape(-1, 3)"), ("turned", POINTS.T, "positions.T"),
                                  ("deep", POINTS[None], "reshape(-1, 3)"), ("complex", POINTS.astype(complex), "astype"),
                                  ("text", POINTS.astype("S8"), "astype"), ("objects", POINTS.astype(object), "astype"),
                                  ("other", records[["id", "x", "y"]].copy(), "no field 'z'")):
            np.save(self.path(name + ".npy"), array)
            self.refuses(self.path(name + ".npy"), says)

    def test_npz(self):
        np.savez(self.path("one.npz"), points=POINTS)
        self.assertEqual(self.check(self.path("one.npz"), POINTS)["input"]["taken"], "array 'points'")
        for save in (np.savez, np.savez_compressed):
            save(self.path("two.npz"), a=POINTS.astype("f4"), b=np.asfortranarray(POINTS[:10]), c=np.zeros((3, 5)))
            self.refuses(self.path("two.npz"), "'a', 'b', 'c'", "--array", code=2)
            self.refuses(self.path("two.npz"), "no array 'd'", args=("--array", "d"), code=2)
            self.check(self.path("two.npz"), POINTS.astype("f4"), "--array", "a")
            self.check(self.path("two.npz"), POINTS[:10], "--array", "b")
            self.assertEqual(self.check(self.path("two.npz"), np.zeros((3, 3)), "--array", "c", "--columns", "0,2,4")["input"]["taken"],
                             "array 'c', columns 0, 2 and 4 of 5")
            whole = self.bytes(self.path("two.npz"))
            for size in (0, 10, len(whole) // 2, len(whole) - 1):
                self.refuses(self.text("cut.npz", whole[:size]), "expected", args=("--array", "a"))
            at = whole.index(POINTS.astype("f4").tobytes()[:16]) if save is np.savez else 200
            damaged = whole[:at] + bytes([whole[at] ^ 1]) + whole[at + 1:]
            self.refuses(self.text("damaged.npz", damaged), "expected", args=("--array", "a"))
        self.refuses(self.text("zip.npz", b"PK\x05\x06" + bytes(18)), "no arrays")
        with zipfile.ZipFile(self.path("text.npz"), "w") as archive:
            archive.writestr("a.txt", "1 2 3")
        self.refuses(self.path("text.npz"), "not an .npy")

    def test_text(self):
        rows = [" ".join(map(repr, row)) for row in POINTS.tolist()]
        for name in ("a.xyz", "a.txt", "a.pts", "a.csv", "A.XYZ"):
            self.check(self.text(name, "\n".join(rows) + "\n"), POINTS)
        self.check(self.text("n.pts", "60\n" + "\n".join(row + " 0.5 1 2 3" for row in rows)), POINTS)
        np.savetxt(self.path("np.txt"), POINTS, fmt="%.17g")
        self.check(self.path("np.txt"), POINTS)
        np.savetxt(self.path("np.csv"), POINTS, fmt="%.17g", delimiter=",", header="x,y,z")
        self.check(self.path("np.csv"), POINTS)
        table = "id,Y,X,Z\n" + "\n".join(f"{i},{y!r},{x!r},{z!r}" for i, (x, y, z) in enumerate(POINTS.tolist()))
        self.assertEqual(self.check(self.text("t.csv", table), POINTS)["input"]["taken"], "columns 2, 1 and 3 of 4")
        numbered = self.text("n.txt", "\n".join(f"{i} {row}" for i, row in enumerate(rows)))
        done = self.succeeds("search", numbered, "-r", "0.3")
        self.assertIn("--columns 1,2,3", done.err)
        self.assertEqual(self.succeeds("search", numbered, "-r", "0.3", "-q").err, "")
        report = self.check(numbered, POINTS, "--columns", "1,2,3")
        self.assertEqual(report["input"]["notes"], [])
        molecule = self.text("m.xyz", "60\nmade by a test\n" + "\n".join("H " + row for row in rows))
        self.assertIn("angstrom", self.check(molecule, POINTS)["input"]["taken"])

    def test_choices_that_a_file_does_not_offer(self):
        path = self.scene()
        for args, says in ((("--columns", "0,1,2"), "columns"), (("--array", "a"), "array")):
            self.refuses(path, says, args=args, code=2)
        text = self.text("a.xyz", "1 2 3 4\n")
        self.refuses(text, "array", args=("--array", "a"), code=2)
        self.refuses(text, "grids", args=("--grid", "a"), code=2)
        self.refuses(text, "three different", args=("--columns", "0,1,1"), code=2)
        for columns in ("0,1", "0,1,2,3", "a,b,c", "0,1,", "-1,0,1", "0 1 2", ""):
            self.fails(2, "search", text, "-r", "1", "--columns", columns, says="--columns")

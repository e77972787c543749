"""tools/render.py: draws every kind of attribute of a .ply and an .npz, and says in a sentence what it cannot draw.

usage: test_render.py TOOLS/render.py
"""
import os
import subprocess
import sys
import tempfile
import unittest

import numpy as np

RENDER = None  # set below
PLY_HEADER = """ply
format binary_little_endian 1.0
element vertex 300
property double x
property double y
property double z
property float nns_density
property int nns_cluster
property float stretch_x
property float stretch_y
property float stretch_z
property uchar nns_isolated
end_header
"""


class Render(unittest.TestCase):
    def setUp(self):
        self.folder = tempfile.TemporaryDirectory()
        self.addCleanup(self.folder.cleanup)
        random = np.random.default_rng(1)
        self.positions = random.uniform(size=(300, 3))
        self.positions[7] = np.nan
        axes = np.linalg.qr(random.normal(size=(300, 3, 3)))[0]
        self.arrays = {
            "nns_density": random.uniform(size=300).astype("f4"), "nns_count": np.arange(300, dtype="i4"),
            "nns_cluster": (np.arange(300) % 9 - 1).astype("i4"), "nns_cluster_size": np.full(300, 30, "i4"),
            "nns_normal": axes[:, 0].astype("f4"), "average_v": random.normal(size=(300, 3)),
            "nns_nearest_distance": np.full(300, -1, "f4"), "nns_isolated": np.arange(300) % 3 == 0,
            "stretch": random.uniform(1, 2, (300, 3)).astype("f4"), "xform": axes.astype("f4"),
        }
        self.whole, self.bare = self.path("whole.npz"), self.path("bare.npz")
        np.savez(self.whole, positions=self.positions, **self.arrays)
        np.savez(self.bare, **self.arrays)

    def path(self, name):
        return os.path.join(self.folder.name, name)

    def render(self, *arguments):
        return subprocess.run([sys.executable, "-B", RENDER, *arguments, "-o", self.path("out.png")], capture_output=True, text=True)

    def assert_drawn(self, *arguments):
        done = self.render(*arguments)
        self.assertEqual((done.returncode, done.stderr), (0, ""), arguments)
        with open(self.path("out.png"), "rb") as file:
            self.assertEqual(file.read(8), b"\x89PNG\r\n\x1a\n")
        os.remove(self.path("out.png"))

    def assert_refused(self, *arguments):
        done = self.render(*arguments)
        self.assertEqual((done.returncode, done.stdout), (3, ""), done.stderr)
        self.assertEqual(done.stderr.count("\n"), 1, done.stderr)
        self.assertFalse(os.path.exists(self.path("out.png")))
        return done.stderr

    def test_every_kind_is_drawn(self):
        names = ["density", "count", "cluster", "cluster_size", "normal", "average_v", "nearest_distance", "isolated", "pca"]
        self.assert_drawn(self.whole, *(word for name in names for word in ("--attribute", name)))
        self.assert_drawn(self.whole, "--attribute", "pca", "--ellipses", "0.05", "--axis", "z", "--slice", "0.2", "0.6")

    def test_positions_of_another_file(self):
        np.save(self.path("positions.npy"), self.positions)
        self.assert_drawn(self.bare, "--positions", self.path("positions.npy"), "--attribute", "nns_density")
        self.assertIn("has no positions", self.assert_refused(self.bare, "--attribute", "density"))
        np.save(self.path("positions.npy"), self.positions[1:])
        self.assertIn("300 values for 299 points",
                      self.assert_refused(self.bare, "--positions", self.path("positions.npy"), "--attribute", "density"))

    def test_a_ply(self):
        rows = np.zeros(300, [(name, "<f8") for name in "xyz"] + [("density", "<f4"), ("cluster", "<i4"), ("s", "<f4", 3),
                                                                  ("isolated", "u1")])
        for name, values in zip("xyz", self.positions.T):
            rows[name] = values
        rows["s"] = 1
        with open(self.path("a.ply"), "wb") as file:
            file.write(PLY_HEADER.encode() + rows.tobytes())
        for name in ("density", "cluster", "pca", "isolated"):
            self.assert_drawn(self.path("a.ply"), "--attribute", name)
        with open(self.path("cut.ply"), "wb") as file:
            file.write(PLY_HEADER.encode() + rows[1:].tobytes())
        self.assertIn("299 points instead of 300", self.assert_refused(self.path("cut.ply"), "--attribute", "density"))

    def test_what_is_not_there_is_named(self):
        said = self.assert_refused(self.whole, "--attribute", "mass")
        self.assertIn("has no attribute 'mass'; those there are: average_v, nns_cluster,", said)
        self.assertIn("No such file", self.assert_refused(self.path("none.npz"), "--attribute", "density"))
        self.assertIn("no point is left", self.assert_refused(self.whole, "--attribute", "density", "--axis", "z", "--slice", "5", "6"))
        self.assertIn("matrices", self.assert_refused(self.whole, "--attribute", "xform"))


if __name__ == "__main__":
    RENDER = os.path.abspath(sys.argv.pop())
    unittest.main()

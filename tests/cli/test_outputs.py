"""Files that the program writes: whole or not at all, never over something by accident."""
import filecmp
import json
import os
import shutil
import subprocess

import numpy as np

import cli_case
from cli_case import CliCase, limit_file_size, run, watched


def without_uuid(path):
    with open(path, "rb") as file:
        data = file.read()
    return data[:21] + data[57:]


class Targets(CliCase):
    def test_existing_file(self):
        path, out = self.scene(), self.text("out.npz", "precious")
        self.fails(2, "search", path, "-o", out, says=["out.npz", "force"])
        with open(out) as file:
            self.assertEqual(file.read(), "precious")
        self.succeeds("search", path, "-o", out, "-f", "-q")
        self.assertGreater(os.path.getsize(out), 1000)
        self.fails(2, "scene", "block", "-n", "10", "-o", path, says="block.vdb")

    def test_checks_come_before_work(self):
        # The input does not exist either: that the output is named shows what was looked at first.
        out = self.text("out.npz", "precious")
        self.fails(2, "search", self.path("missing.vdb"), "-r", "1", "-o", out, says="out.npz")

    def test_unknown_extension(self):
        path = self.scene()
        for name in ("x.csv", "x", "x.npz.gz", ".npz"):
            self.fails(2, "search", path, "-o", self.path(name), says=name)

    def test_not_a_regular_file(self):
        path = self.scene()
        os.mkdir(self.path("folder.npz"))
        os.mkfifo(self.path("pipe.npz"))
        os.symlink("/dev/null", self.path("null.npz"))
        os.symlink("/dev/null", self.path("null.vdb"))
        for name in ("folder.npz", "pipe.npz", "null.npz", "null.vdb"):
            for force in ([], ["-f"]):
                self.fails(2, "search", path, "-o", self.path(name), *force, says=name)
        self.fails(2, "search", path, "--json", "/dev/null", "-f", says="/dev/null")
        self.assertTrue(os.path.islink(self.path("null.npz")))
        self.assertTrue(os.path.exists("/dev/null") and not os.path.isfile("/dev/null"))

    def test_missing_folder(self):
        self.fails(6, "search", self.scene(), "-o", self.path("no/such/x.npz"), says="x.npz")

    def test_no_permission(self):
        if os.geteuid() == 0:
            self.skipTest("root may write everywhere")
        path = self.scene()
        os.mkdir(self.path("closed"), 0o500)
        self.fails(6, "search", path, "-o", self.path("closed/x.npz"), says="x.npz")

    def every_output(self):
        """A command line for each kind of output, which ends with the flag of its file."""
        path = self.scene()
        bench = ["bench", path, "--method", "ours-count", "--repeat", "1", "--sample", "0"]
        return {"x.npz": ["search", path, "-o"], "x.vdb": ["search", path, "-o"], "x.json": ["search", path, "--json"],
                "x.svg": ["plan", path, "--svg"], "x.csv": [*bench, "--csv"], "x.raw": [*bench, "--points-out"],
                "x.html": [*bench, "--study", "methods", "--chart"], "s.vdb": ["scene", "block", "-n", "50", "-o"],
                **{"points." + kind: ["convert", path, "-o"] for kind in ("vdb", "ply", "npz", "npy")}}

    def test_links_and_permissions_are_kept(self):
        os.mkdir(self.path("elsewhere"))
        outputs = self.every_output()
        for name, args in outputs.items():
            target, link = self.text("elsewhere/" + name, "old"), self.path(name)
            os.chmod(target, 0o600)
            os.symlink("elsewhere/" + name, link)
            self.fails(2, *args, link, says=[name, "force"])
            self.assertEqual(self.bytes(target), b"old")
            done = run(*args, link, "-f", "-q")
            if name == "x.html" and done.code == 6 and "python3-matplotlib" in done.err:
                continue # drawing needs Matplotlib
            self.assertEqual(done.code, 0, done.err)
            self.assertTrue(os.path.islink(link), name)
            self.assertNotEqual(self.bytes(target), b"old", name)
            self.assertEqual(os.stat(target).st_mode & 0o777, 0o600, name)
        self.assertEqual(sorted(os.listdir(self.path("elsewhere"))), sorted(outputs))

    def test_what_a_process_of_the_same_number_left(self):
        for name, args in self.every_output().items():
            out = self.path(name)

            def leave_some():
                for count in range(8):
                    with open(f"{out}.vdb_nns-{cli_case.host_mark()}-{os.getpid():x}-{count:x}.tmp", "w"):
                        pass
            self.assertIn(run(*args, out, preexec_fn=leave_some).code, (0, 6) if name == "x.html" else (0,))
            self.assertEqual([left for left in os.listdir(self.folder) if left.endswith(".tmp")], [])

    def test_sync(self):
        """The file before it has its name, the folder after."""
        calls, folder = self.path("calls"), os.path.realpath(self.folder)
        for name, args in self.every_output().items():
            if name == "x.html":
                continue # is written as the others are
            out = os.path.join(folder, name)
            for force in ([], ["-f"]):
                self.succeeds(*args, out, "--sync", *force, env=watched(VDB_NNS_CALLS=calls))
                found = self.bytes(calls).decode().splitlines()
                os.remove(calls)
                self.assertEqual(len(found), 3, found)
                temporary = found[0].split(" ")[1]
                self.assertTrue(temporary.startswith(out + ".vdb_nns-"))
                self.assertEqual(found, [f"flush {temporary}", f"rename {temporary} {out}", f"flush {folder}"])
            self.succeeds(*args, out, "-f", env=watched(VDB_NNS_CALLS=calls))
            self.assertEqual(len(self.bytes(calls).decode().splitlines()), 1) # no flush unless asked for
            os.remove(calls)


class NoSpace(CliCase):
    def test_size_limit(self):
        path = self.scene("block", 20000)
        os.mkdir(self.path("out"))
        for name in ("x.npz", "x.vdb"):
            out = self.path("out/" + name)
            self.fails(6, "search", path, "-o", out, says=name, preexec_fn=limit_file_size(100000))
            self.assertEqual(os.listdir(self.path("out")), [])
        self.fails(6, "search", path, "--json", self.path("out/x.json"), says="x.json",
                   preexec_fn=limit_file_size(500))
        self.fails(6, "scene", "block", "-n", "50k", "-o", self.path("out/s.vdb"), says="s.vdb",
                   preexec_fn=limit_file_size(100000))
        self.assertEqual(os.listdir(self.path("out")), [])

    def test_size_limit_leaves_the_old_file(self):
        path, out = self.scene("block", 20000), self.text("out.npz", "precious")
        self.fails(6, "search", path, "-o", out, "-f", says="out.npz", preexec_fn=limit_file_size(100000))
        with open(out) as file:
            self.assertEqual(file.read(), "precious")
        before = without_uuid(path)
        self.fails(6, "search", path, "-o", path, "-f", says="block.vdb", preexec_fn=limit_file_size(100000))
        self.assertEqual(without_uuid(path), before)

    def test_disk_full(self):
        disk = self.path("disk")
        os.mkdir(disk)
        mounted = os.geteuid() == 0 and subprocess.run(
            ["mount", "-t", "tmpfs", "-o", "size=64k", "none", disk], stderr=subprocess.DEVNULL).returncode == 0
        if not mounted:
            self.skipTest("cannot mount a small tmpfs here; the size limit stands in for it")
        try:
            path = self.scene("block", 20000)
            for name in ("x.npz", "x.vdb"):
                self.fails(6, "search", path, "-o", os.path.join(disk, name), says=name)
                self.assertEqual(os.listdir(disk), [])
        finally:
            subprocess.run(["umount", disk], check=True)


    def test_disk_with_room_for_one_file(self):
        # Blocks that are reserved, or written, are not asked for a second time.
        path, free, disk = self.scene("block", 200000), self.path("free.npz"), self.path("disk")
        os.mkdir(disk)
        for lists in ("connectivity", "distance"):
            self.succeeds("search", path, "-o", free, "-f", "--lists", lists, "-q")
            size = os.path.getsize(free) * 13 // 10
            mount = ["mount", "-t", "tmpfs", "-o", f"size={size}", "none", disk]
            if os.geteuid() != 0 or subprocess.run(mount, stderr=subprocess.DEVNULL).returncode != 0:
                self.skipTest("cannot mount a small tmpfs here")
            try:
                with self.subTest(lists=lists):
                    out = os.path.join(disk, "x.npz")
                    done = self.succeeds("search", path, "-o", out, "--lists", lists)
                    self.assertIn("straight to the file", done.out)
                    self.assertTrue(filecmp.cmp(free, out, shallow=False))
            finally:
                subprocess.run(["umount", disk], check=True)


class VdbOutput(CliCase):
    def test_counts_are_added(self):
        path, out = self.scene(), self.path("out.vdb")
        self.succeeds("search", path, "-o", out, "-q")
        info = self.report("info", out)
        self.assertIn({"name": "nns_count", "type": "int32", "codec": "null"}, info["attributes"])
        before = self.report("info", path)
        for key in ("points", "grid", "transform", "codec", "bbox", "suggested_radius"):
            self.assertEqual(info[key], before[key])
        self.assertEqual(self.report("search", out, "--checksum")["result"],
                         self.report("search", path, "--checksum")["result"])

    def test_existing_attribute(self):
        path, once = self.scene(), self.path("once.vdb")
        self.succeeds("search", path, "-o", once, "-q")
        self.fails(2, "search", once, "-o", self.path("twice.vdb"), says=["nns_count", "--force"])
        self.succeeds("search", once, "-o", self.path("twice.vdb"), "-f", "-q")
        self.succeeds("search", once, "-o", self.path("other.vdb"), "--prefix", "my_", "-q")
        names = [a["name"] for a in self.report("info", self.path("other.vdb"))["attributes"]]
        self.assertEqual(sorted(names), ["P", "my_count", "nns_count"])

    def test_output_is_the_input(self):
        path, copy = self.scene(), self.path("copy.vdb")
        shutil.copy(path, copy)
        self.fails(2, "search", path, "-o", path, says="block.vdb")
        self.succeeds("search", path, "-o", path, "-f", "-q")
        self.succeeds("search", copy, "-o", self.path("out.vdb"), "-q")
        self.assertEqual(without_uuid(path), without_uuid(self.path("out.vdb")))

    def test_other_grids_are_kept(self):
        out = self.path("out.vdb")
        self.succeeds("search", self.fixture("two_grids.vdb"), "-g", "second", "-r", "1", "-o", out, "-q")
        for grid, expected in (("first", ["P"]), ("second", ["P", "nns_count"])):
            info = self.report("info", out, "-g", grid)
            self.assertEqual([a["name"] for a in info["attributes"]], expected)

    def test_same_bytes_for_any_thread_count(self):
        path = self.scene("clusters", 3000)
        files = []
        for threads in ("1", "2"):
            out = self.path(f"out{threads}.vdb")
            self.succeeds("search", path, "-o", out, "-T", threads, "-q")
            files.append(without_uuid(out))
        self.assertEqual(files[0], files[1])

    def test_several_outputs(self):
        path = self.scene()
        report = self.report("search", path, "-o", self.path("a.npz"), "-o", self.path("b.vdb"))
        self.assertEqual(len(np.load(self.path("a.npz"))["indices"]), report["result"]["pairs"])
        self.assertEqual(self.report("info", self.path("b.vdb"))["points"], 2000)
        done = run("search", path, "-o", self.path("c.npz"))
        self.assertRegex(done.out, r"(?m)^written +.*c\.npz$")
        json.loads(run("search", path, "--json", "-", "-o", self.path("d.npz"), "-q").out)

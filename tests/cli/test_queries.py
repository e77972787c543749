"""Other queries, groups, radii of points, the nearest K, order, self: what search finds, what verify passes and finds, and every
refusal."""
import os
import re
import zipfile

import numpy as np

import cli_case
from cli_case import CliCase

KINDS = ("gather", "scatter", "symmetric")


def good(radii):
    return np.where(np.isfinite(radii) & (radii > 0), radii, -np.inf)


def rows_of(queries, points, radius, mode="gather", query_radii=None, point_radii=None, one_set=True, chosen=(None, None),
            nearest=0, by_distance=False, include_self=False):
    """Lists by brute force in doubles, for points without ties."""
    distances = np.linalg.norm(queries[:, None] - points[None], axis=2)
    reach = np.full(distances.shape, radius if query_radii is None and point_radii is None else -np.inf)
    if query_radii is not None and mode != "scatter":
        reach = np.maximum(reach, good(query_radii)[:, None])
    if point_radii is not None and mode != "gather":
        reach = np.maximum(reach, good(point_radii)[None])
    near = distances <= reach
    if one_set:
        np.fill_diagonal(near, False)
    if chosen[0] is not None:
        near &= chosen[0][:, None]
    if chosen[1] is not None:
        near &= chosen[1][None]
    rows = []
    for i in range(len(queries)):
        row = np.flatnonzero(near[i])
        if nearest:
            row = row[np.argsort(distances[i][row], kind="stable")][:nearest]
        if include_self and (chosen[0] is None or chosen[0][i]) and (chosen[1] is None or chosen[1][i]):
            row = np.append(row, i)
        row = np.sort(row)
        rows.append(row[np.argsort(distances[i][row], kind="stable")] if by_distance else row)
    return rows, distances


class Queries(CliCase):
    def setUp(self):
        super().setUp()
        random = np.random.default_rng(5)
        self.points, self.probes = random.random((300, 3)), random.random((120, 3))
        self.radii, self.probe_radii = random.random(300) * 0.3, random.random(120) * 0.3
        self.radii[[3, 50, 77]] = np.nan, 0, -1
        self.probe_radii[4] = np.inf
        self.input = self.npy("points.npy", self.points, np.float64)
        self.queries = self.npy("probes.npy", self.probes, np.float64)
        self.radius_file = self.npy("radii.npy", self.radii, np.float64)
        self.queries_radius_file = self.npy("probe_radii.npy", self.probe_radii, np.float64)
        self.vdb = self.fixture("named_values.vdb")

    def lists(self, rows, columns, distances=None, name="lists.npz"):
        sizes = [len(row) for row in rows]
        indices = np.concatenate(rows + [np.zeros(0, int)]).astype(np.int32)
        data = np.ones(len(indices), np.int8)
        if distances is not None:
            data = distances[np.repeat(np.arange(len(rows)), sizes), indices].astype(np.float32)
        arrays = {"indptr": np.append(0, np.cumsum(sizes)).astype(np.int64), "indices": indices, "data": data,
                  "shape": np.array([len(rows), columns], np.int64), "format": np.array(b"csr")}
        with zipfile.ZipFile(self.path(name), "w", zipfile.ZIP_STORED) as archive:
            for member, values in arrays.items():
                with archive.open(member + ".npy", "w") as file:
                    np.lib.format.write_array(file, values)
        return self.path(name)

    def finds(self, input, rows, columns, *args, distances=None):
        """search writes the rows, however it holds them."""
        out = self.path("found.npz")
        ways = [[], ["--encoding", "index", "-T", "1"], ["--lists", "distance"], ["--host-memory", "150MiB"]]
        if "--nearest" not in args:
            ways.append(["--encoding", "mask"])
        checksums = set()
        for way in ways:
            report = self.report("search", input, "-o", out, "--force", *args, *way)
            found = np.load(out)
            self.assertEqual(found["shape"].tolist(), [len(rows), columns], way)
            self.assertEqual(np.diff(found["indptr"]).tolist(), [len(row) for row in rows], way)
            self.assertEqual(found["indices"].tolist(), np.concatenate(rows).tolist(), way)
            if distances is not None and "distance" in way:
                expected = distances[np.repeat(np.arange(len(rows)), [len(row) for row in rows]), found["indices"]]
                np.testing.assert_allclose(found["data"], expected, rtol=1e-6)
            self.assertEqual(report["result"]["pairs"], len(found["indices"]), way)
            checksums.add(report["result"]["checksum"])
        counted = self.report("search", input, "--checksum", *args)["result"]
        self.assertEqual(checksums | {counted["checksum"]}, checksums)
        self.assertEqual(len(checksums), 1)
        for key in ("pairs", "min", "mean", "max", "isolated", "shortened", "bad_radii"):
            self.assertEqual(report["result"][key], counted[key], key)
        return report["result"]

    def passes(self, input, rows, columns, *args, distances=None):
        """The rows are right, and found; a pair less or more is not right."""
        self.finds(input, rows, columns, *args, distances=distances)
        path = self.lists(rows, columns, distances)
        report = self.report("verify", input, path, *args)
        self.assertTrue(report["passed"])
        self.assertGreater(report["listed_pairs"], 0)
        self.assertTrue(self.report("verify", input, path, "--sample", "50", *args)["passed"])
        row = next(i for i, r in enumerate(rows) if len(r) > 1)
        changed = list(rows)
        changed[row] = rows[row][1:]
        done = cli_case.run("verify", input, self.lists(changed, columns), *args)
        self.assertEqual(done.code, 1, done.err)
        self.assertRegex(done.out, r"(?m)^ +missing +1$")
        return report

    def test_other_queries(self):
        rows, distances = rows_of(self.probes, self.points, 0.2, one_set=False)
        self.passes(self.input, rows, 300, "--queries", self.queries, "-r", "0.2", distances=distances)
        # The points themselves as queries: nobody is self.
        rows, _ = rows_of(self.points, self.points, 0.2, one_set=False)
        self.passes(self.input, rows, 300, "--queries", self.input, "-r", "0.2")

    def test_nearest_order_self(self):
        for nearest in (0, 1, 4):
            for order in ("number", "distance"):
                for self_flag in ([], ["--include-self"]):
                    args = ["-r", "0.2", "--order", order, *(["--nearest", nearest] if nearest else []), *self_flag]
                    with self.subTest(args):
                        rows, distances = rows_of(self.points, self.points, 0.2, nearest=nearest,
                                                  by_distance=order == "distance", include_self=bool(self_flag))
                        if nearest != 1 or self_flag:
                            self.passes(self.input, rows, 300, *args, distances=distances)
                        self.succeeds("verify", self.input, self.lists(rows, 300), *args)
        by_number, _ = rows_of(self.points, self.points, 0.2)
        done = cli_case.run("verify", self.input, self.lists(by_number, 300), "-r", "0.2", "--order", "distance")
        self.assertEqual(done.code, 1)
        self.assertRegex(done.out, r"(?m)^ +unsorted +[1-9]")

    def test_radii_of_one_set(self):
        for mode in KINDS:
            with self.subTest(mode):
                rows, _ = rows_of(self.points, self.points, 0, mode, self.radii, self.radii)
                report = self.passes(self.input, rows, 300, "--radius-file", self.radius_file, "--radius-mode", mode)
                self.assertEqual((report["radius"], report["bad_radii"]), (None, 3))
                rows, _ = rows_of(self.points, self.points, 0, mode, self.radii * 0.7, self.radii * 0.7, nearest=3)
                self.passes(self.input, rows, 300, "--radius-file", self.radius_file, "--radius-mode", mode,
                            "--radius-scale", "0.7", "--nearest", "3")

    def test_radii_of_two_sets(self):
        files = {"gather": ["--queries-radius-file", self.queries_radius_file],
                 "scatter": ["--radius-file", self.radius_file]}
        files["symmetric"] = files["gather"] + files["scatter"]
        for mode in KINDS:
            with self.subTest(mode):
                rows, _ = rows_of(self.probes, self.points, 0, mode, self.probe_radii, self.radii, one_set=False)
                report = self.passes(self.input, rows, 300, "--queries", self.queries, "--radius-mode", mode, *files[mode])
                self.assertEqual(report["bad_radii"], {"gather": 1, "scatter": 3, "symmetric": 4}[mode])

    def ply(self, name, positions, radii, binary=True):
        header = ["ply", "format " + ("binary_big_endian" if binary else "ascii") + " 1.0",
                  f"element vertex {len(positions)}", "property uchar tag", "property double x", "property double y",
                  "property double z", "property float pscale", "property list uchar int near", "end_header", ""]
        if binary:
            record = np.zeros(len(positions), [("t", "u1"), ("p", ">f8", 3), ("r", ">f4"), ("n", "u1")])
            record["p"], record["r"] = positions, radii
            body = record.tobytes()
        else:
            body = "".join(f"7 {x!r} {y!r} {z!r} {np.float32(r)!s} 1 5\n"
                           for (x, y, z), r in zip(positions.tolist(), radii)).encode()
        return self.text(name, "\n".join(header).encode() + body)

    def test_properties_of_a_ply(self):
        radii = self.radii.astype(np.float32).astype(float)
        rows, _ = rows_of(self.points, self.points, 0, "gather", radii * 2)
        for binary in (True, False):
            path = self.ply("points.ply", self.points, self.radii, binary)
            self.passes(path, rows, 300, "--radius-attribute", "pscale", "--radius-scale", "2")
            self.fails(2, "verify", path, self.lists(rows, 300), "--radius-attribute", "pscal",
                       says=["no property 'pscal'; did you mean 'pscale'?", "'tag'"])
            self.fails(3, "verify", path, self.lists(rows, 300), "--radius-attribute", "near", says="list uchar int")
        names = [a["name"] for a in self.report("info", path)["attributes"]]
        self.assertEqual(names, ["tag", "x", "y", "z", "pscale", "near"])

    def raw(self, name):
        return np.fromfile(self.fixture(name), np.float64).reshape(-1, 3)

    def test_attributes_and_groups_of_a_vdb(self):
        points = self.raw("named_values_points.f64")
        number = np.arange(len(points))
        radii = 0.05 * (1 + number % 7)
        even, third = number % 2 == 0, number % 3 == 0
        args = ("-g", "points")
        for mode in KINDS:
            rows, _ = rows_of(points, points, 0, mode, radii, radii)
            self.passes(self.vdb, rows, len(points), *args, "--radius-attribute", "mass", "--radius-mode", mode)
        for queries, candidates, chosen in (("even", None, (even, None)), (None, "^third,even", (None, even & ~third)),
                                            ("even, third", "^even", (even | third, ~even))):
            more = [*(["--query-group", queries] if queries else []),
                    *(["--candidate-group", candidates] if candidates else [])]
            rows, _ = rows_of(points, points, 0.2, chosen=chosen, include_self=True)
            self.passes(self.vdb, rows, len(points), *args, "-r", "0.2", *more, "--include-self")

    def test_two_grids(self):
        points, probes = self.raw("named_values_points.f64"), self.raw("named_values_probes.f64")
        rows, distances = rows_of(probes, points, 0.3, one_set=False)
        args = ("-g", "points", "--queries-grid", "probes", "-r", "0.3")
        self.passes(self.vdb, rows, len(points), *args, distances=distances)
        self.passes(self.vdb, rows, len(points), "--queries", self.vdb, *args)
        rows, _ = rows_of(self.probes, points, 0.3, one_set=False)
        self.passes(self.vdb, rows, len(points), "-g", "points", "--queries", self.queries, "-r", "0.3")
        rows, _ = rows_of(points, self.points, 0.3, one_set=False, chosen=(np.arange(len(points)) % 2 == 0, None))
        self.passes(self.input, rows, 300, "--queries", self.vdb, "--queries-grid", "points", "-r", "0.3",
                    "--query-group", "even")

    def test_flags_that_do_not_go_together(self):
        lists = self.lists(*[rows_of(self.points, self.points, 0.1)[0], 300])
        radii, queries = ("--radius-file", self.radius_file), ("--queries", self.queries)
        others = ("--queries-radius-file", self.queries_radius_file)
        for args, says in (
                (["-r", "0.1", *radii], "-r and --radius-file do not go together"),
                (["-r", "0.1", "--radius-attribute", "a"], "-r and --radius-attribute do not go together"),
                (["--radius-attribute", "a", *radii], "--radius-attribute and --radius-file do not go together"),
                (["--radius-attribute", "a", *queries, *others], "--radius-attribute and --queries-radius-file do not"),
                ([*others], "there are none"),
                ([*radii, *others], "there are none"),
                ([*queries, *radii], "--queries-radius-file is missing"),
                ([*queries, *others, "--radius-mode", "scatter"], "--radius-file is missing"),
                ([*queries, *others, "--radius-mode", "symmetric"], "--radius-file is missing"),
                ([*queries, *radii, "--radius-mode", "symmetric"], "--queries-radius-file is missing"),
                (["-r", "0.1", "--radius-scale", "1"], "--radius-scale is about radii"),
                (["-r", "0.1", "--radius-mode", "gather"], "--radius-mode is about radii"),
                ([*radii, "--radius-scale", "0"], "--radius-scale"),
                ([*radii, "--radius-scale", "nan"], "--radius-scale"),
                ([*radii, "--radius-mode", "both"], "--radius-mode"),
                (["-r", "0.1", "--nearest", "0"], "--nearest"),
                (["-r", "0.1", "--nearest", "1.5"], "--nearest"),
                (["-r", "0.1", "--nearest", "-1"], "--nearest"),
                (["-r", "0.1", "--nearest", "5G"], "--nearest"),
                (["-r", "0.1", "--nearest", ""], "--nearest"),
                (["-r", "0.1", "--order", "size"], "--order"),
                (["-r", "0.1", "--include-self", *queries], "--include-self and --queries do not go together"),
                (["-r", "0.1", "--query-group", "a"], "has no point groups"),
                (["-r", "0.1", "--candidate-group", "a"], "has no point groups"),
                (["-r", "0.1", "--queries-grid", "a"], "has no grids"),
                (["--radius-attribute", "a"], "has no named values"),
                ([], "no radius")):
            with self.subTest(args):
                self.fails(2, "verify", self.input, lists, *args, says=says)
                self.fails(2, "search", self.input, *args, says=says)
                if says == "no radius":
                    continue
                # Before a byte is read.
                self.fails(2, "verify", self.path("missing.npy"), lists, *args, says=says)
        self.fails(2, "verify", self.vdb, lists, "-g", "points", "--queries-grid", "probes", "--include-self", "-r", "1",
                   says="--include-self and --queries-grid do not go together")

    def refused_rows(self, mark):
        """Of a table in docs/cli.md: flags, each with its value if it has one, and the reason."""
        with open(os.path.join(os.path.dirname(os.path.abspath(__file__)), "..", "..", "docs", "cli.md")) as file:
            table = re.search(f"<!-- {mark} -->(.*?)<!-- end", file.read(), re.S).group(1)
        rows = [line.split("|")[1:3] for line in table.strip().splitlines()[2:]]
        return [([flag.split() for flag in re.findall(r"`([^`]+)`", flags)], why) for flags, why in rows]

    def test_the_table_of_refused_measures(self):
        """Each row is refused before a byte is read, and the message has one of the flags."""
        rows = self.refused_rows("refused flags of measures")
        self.assertGreater(len(rows), 15)
        of_file = {"--queries": self.vdb, "--queries-grid": "probes"}
        for words, _ in rows:
            args = [word for flag in words for word in (*flag, *([of_file[flag[0]]] if len(flag) == 1 else []))]
            args = [self.path(word) if word.startswith(("out.", "lists.")) else word for word in args]
            with self.subTest(args):
                done = self.fails(2, "search", self.path("missing.vdb"), "-r", "0.1", *args)
                names = [word for flag in words for word in flag if word != "-o"]
                self.assertTrue(any(name.split(",")[0] in done.err for name in names), done.err)
                if len(words) > 2:  # the last one is what is wrong: without it, the file is missed
                    self.fails(3, "search", self.path("missing.vdb"), "-r", "0.1", *args[:-2], says="cannot be read")

    def test_the_table_of_refused_flags(self):
        """docs/cli.md says which flags do not go together: each row is refused, and says so with these flags."""
        values = {"-r": "0.1", "--radius-attribute": "mass", "--radius-file": self.radius_file, "--queries": self.vdb,
                  "--queries-radius-file": self.queries_radius_file, "--radius-scale": "2", "--radius-mode": "gather",
                  "--queries-grid": "probes"}
        rows = self.refused_rows("refused flags")
        self.assertGreater(len(rows), 10)
        for words, why in rows:
            args = [word for flag in words for word in (*flag, *([values[flag[0]]] if flag[0] in values and len(flag) == 1 else []))]
            missing = re.search(r"`(--[a-z-]+)` is missing", why)
            with self.subTest(args):
                says = [missing.group(1) + " is missing"] if missing else [flag[0] for flag in words]
                for command in (("verify", self.path("missing.vdb"), self.path("lists.npz")),
                                ("search", self.path("missing.vdb"))):
                    done = self.fails(2, *command, *args)
                    self.assertTrue(any(name in done.err for name in says), done.err)

    def test_what_search_alone_refuses(self):
        self.fails(2, "search", self.input, "-r", "0.1", "--nearest", "2", "--encoding", "mask", says="--encoding mask and --nearest")
        for flags in (["-r", "0.1", "--queries", self.queries], ["--radius-file", self.radius_file], ["-r", "0.1", "--nearest", "2"],
                      ["-r", "0.1", "--include-self"]):
            self.fails(2, "search", self.input, *flags, "--device", "sim", says="use --device cpu")
        self.fails(1, "search", self.input, "--radius-file", self.radius_file, "--nonfinite", "fail", says="3 points have a radius")
        for output in (self.queries, self.radius_file):
            self.fails(2, "search", self.input, "--queries", self.queries, "--queries-radius-file", self.queries_radius_file,
                       "--radius-file", self.radius_file, "--radius-mode", "symmetric", "--json", output, "--force")

    def test_counts_of_other_queries_go_to_their_file(self):
        points, probes = self.raw("named_values_points.f64"), self.raw("named_values_probes.f64")
        rows, _ = rows_of(probes, points, 0.3, one_set=False, nearest=5)
        out = self.path("counted.vdb")
        report = self.report("search", self.vdb, "-g", "points", "--queries-grid", "probes", "-r", "0.3", "--nearest", "5", "-o", out)
        self.assertEqual(report["queries"]["points"], len(probes))
        self.assertEqual(report["result"]["shortened"], sum(len(r) > 5 for r in rows_of(probes, points, 0.3, one_set=False)[0]))
        attributes = {g: [a["name"] for a in self.report("info", out, "-g", g)["attributes"]] for g in ("points", "probes")}
        self.assertIn("nns_count", attributes["probes"])
        self.assertNotIn("nns_count", attributes["points"])

    def test_names_that_are_not_there(self):
        lists = self.lists(rows_of(self.points, self.points, 0.1)[0], 300)
        vdb = ("verify", self.vdb, lists, "-g", "points")
        self.fails(2, *vdb, "--radius-attribute", "pscal",
                   says=["no attribute 'pscal'; did you mean 'pscale'? Its attributes are 'P', 'pscale', 'mass', 'v', 'id'"])
        for group in ("--query-group", "--candidate-group"):
            self.fails(2, *vdb, "-r", "1", group, "evn", says="no point group 'evn'; did you mean 'even'? Its groups are")
            self.fails(2, *vdb, "-r", "1", group, "even,,third", says="empty name")
        self.fails(2, *vdb, "-r", "1", "--queries-grid", "probe", says="no point grid 'probe'")
        self.fails(2, *vdb, "--queries-grid", "probes", "--radius-attribute", "pscale", says="no attribute 'pscale'")
        self.fails(2, *vdb, "--queries-grid", "probes", "-r", "1", "--query-group", "even", says="it has no groups")
        for name, kind in (("v", "vec3s"), ("id", "int32"), ("P", "vec3s")):
            self.fails(3, *vdb, "--radius-attribute", name, says=[f"'{name}' has type {kind}", "float or double"])
        missing = self.path("missing.npy")
        self.fails(3, "verify", self.input, lists, "-r", "0.1", "--queries", missing, says=missing)
        self.fails(3, "verify", self.input, lists, "--radius-file", missing, says=missing)

    def test_radius_files_of_another_kind(self):
        lists = self.lists(rows_of(self.points, self.points, 0.1)[0], 300)
        for values, says in ((np.ones(299), "has 299 values"), (np.ones((300, 3)), "has the shape (300, 3)"),
                             (np.ones(300, np.int32), "holds the dtype '<i4'"), (np.ones(300, "f2"), "'<f2'")):
            np.save(self.path("other.npy"), values)
            done = self.fails(3, "verify", self.input, lists, "--radius-file", self.path("other.npy"), says=says)
            self.assertIn("expected are 300 floats of 4 or 8 bytes, shape (300,)", done.err)
        for values in (self.radii.astype(">f8"), self.radii[:, None], np.asfortranarray(self.radii[:, None])):
            np.save(self.path("other.npy"), values)
            rows, _ = rows_of(self.points, self.points, 0, "gather", self.radii)
            self.succeeds("verify", self.input, self.lists(rows, 300), "--radius-file", self.path("other.npy"))
        self.fails(3, "verify", self.input, lists, "-r", "0.1", "--queries", self.queries, says="has 300 rows, but there are 120")

    def test_plans_know_them(self):
        """Tests and bytes of masks follow from the cells, pairs from counted queries: here all of them."""
        radii = ("--radius-file", self.path("radii.npy"))
        np.save(self.path("radii.npy"), self.radii)
        for flags in ((*radii,), (*radii, "--radius-mode", "scatter"), (*radii, "--radius-mode", "symmetric"),
                      ("-r", "0.1", "--queries", self.queries), ("-r", "0.1", "--nearest", "3"),
                      (*radii, "--nearest", "2", "--include-self")):
            found = self.report("search", self.input, *flags, "--checksum")
            planned = self.report("plan", self.input, *flags)
            self.assertAlmostEqual(planned["plan"]["estimated_pairs"], found["result"]["pairs"], places=3)
            self.assertEqual(planned["plan"]["candidate_tests"], found["plan"]["candidate_tests"])
            for key in ("lattices", "leaves", "cells", "cell_size"):
                self.assertEqual(planned["grid"][key], found["grid"][key])
            self.assertEqual(planned["plan"]["blocks_list"], [])
        for flags in (radii, ("-r", "1", "--nearest", "3")):
            self.fails(2, "plan", self.input, *flags, "--device", "sim", says="devices search all points within one radius")
        self.fails(2, "plan", self.input, *radii, "--svg", self.path("plan.svg"), says="--svg draws blocks")
        self.fails(2, "plan", self.input, "-r", "1", "--nearest", "3", "--encoding", "mask", says="masks hold whole lists")

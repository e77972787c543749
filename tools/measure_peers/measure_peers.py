#!/usr/bin/env python3
"""Measures of `vdb_nns` beside those of others: ellipsoids by points::pca() of OpenVDB 13, density by splashsurf, clusters by
scikit-learn. tools/measure_peers.sh makes what this needs and calls it.

    measure_peers.py VDB_NNS PCA_PEER FRAME FOLDER

FRAME: a dam break of splashsurf's repository, particles of radius 0.025. FOLDER: for what is made on the way. Prints a table of
medians of interleaved rounds with two threads, and how far the values of both are apart.
"""

import json
import os
import re
import resource
import statistics
import subprocess
import sys
import time

import numpy as np
import pysplashsurf

THREADS = 2
ROUNDS = 3
MEMORY = 12_000_000_000  # address space of a program, so that one that grows without end is stopped
REST_DENSITY = 1000.0  # splashsurf's default
MIN_NEIGHBORS = 20  # on dam_break 8 % of the points are no core points
SCOPE = re.compile(r"(decomposition|compute_global_density_vector): [≈0-9.]+%, ([0-9.]+)ms avg")


def bound_memory():
    resource.setrlimit(resource.RLIMIT_AS, (MEMORY, MEMORY))


class Program:
    """A program that was run: what it printed, its seconds from start to end, those of all CPUs, and its largest resident memory."""

    def __init__(self, *words):
        begin = time.perf_counter()
        environment = {**os.environ, "RAYON_NUM_THREADS": str(THREADS)}
        process = subprocess.Popen([str(word) for word in words], stdout=subprocess.PIPE, stderr=subprocess.STDOUT,
                                   text=True, preexec_fn=bound_memory, env=environment)
        self.text = process.stdout.read()
        _, status, usage = os.wait4(process.pid, 0)
        self.seconds = time.perf_counter() - begin
        self.cpu_seconds = usage.ru_utime + usage.ru_stime
        self.megabytes = usage.ru_maxrss * 1024 / 1e6
        if status != 0:
            sys.exit(f"measure_peers.py: {' '.join(map(str, words))} failed:\n{self.text}")

    def last_line(self):
        """What a program prints itself; libraries may warn before."""
        return self.text.rstrip().splitlines()[-1]


class Comparison:
    """Seconds and memory of both, a round at a time."""

    def __init__(self, what):
        self.what, self.times, self.memory = what, ([], []), ([], [])

    def add(self, side, seconds, megabytes=None):
        self.times[side].append(seconds)
        if megabytes:
            self.memory[side].append(megabytes)

    def row(self):
        ours, theirs = (statistics.median(times) for times in self.times)
        memory = ["–" if not seen else f"{max(seen):.0f}" for seen in self.memory]
        return f"| {self.what} | {ours:.3g} | {theirs:.3g} | {theirs / ours:.1f} | {memory[0]} | {memory[1]} |"


class Ours:
    def __init__(self, program, folder):
        self.program, self.folder = program, folder

    def run(self, *words):
        return Program(self.program, *words)

    def scene(self, name, count):
        """The file and the radius that it suggests."""
        path = os.path.join(self.folder, f"{name}.vdb")
        self.run("scene", name, "-n", count, "-o", path, "-f")
        return path, json.loads(self.run("info", path, "--json", "-").text)["suggested_radius"]

    def search(self, path, radius, *words):
        """Runs a search that prints its report; returns seconds of grid and pass, and the run."""
        report = os.path.join(self.folder, "report.json")
        run = self.run("search", path, "-r", radius, "-T", THREADS, "-q", "--json", report, "-f", *words)
        with open(report, encoding="utf-8") as file:
            seconds = json.load(file)["seconds"]
        return seconds["grid"] + seconds["search"], run


def compare_ellipsoids(ours, peer):
    points, radius = ours.scene("clusters", "2M")
    made = os.path.join(ours.folder, "pca.npz")
    words = ("--attributes", "pca", "--attributes-output", made)
    over_counting = []
    sizes = {"r/2": radius / 2, "r": radius, "2r": radius * 2}
    cpu = {name: [] for name in sizes}
    rows = {name: Comparison(f"`points::pca`, clusters 2 M, voxels of {name}") for name in sizes}
    values = {name: os.path.join(ours.folder, f"pca_{name.replace('/', '_')}.f64") for name in sizes}
    for _ in range(ROUNDS):
        count_seconds, _ = ours.search(points, radius, "--encoding", "none", "--repeat", 3)
        seconds, run = ours.search(points, radius, *words, "--repeat", 3)
        over_counting.append(seconds / count_seconds)
        for name, size in sizes.items():
            theirs = Program(peer, points, radius, size, THREADS, values[name])
            rows[name].add(0, seconds, run.megabytes)
            seconds_there, cpu_there = map(float, theirs.last_line().split())
            rows[name].add(1, seconds_there, theirs.megabytes)
            cpu[name].append(cpu_there)
    once, more = (ours.search(points, radius, *words, "--repeat", count)[1].cpu_seconds for count in (1, 5))
    own = (more - once) / 4
    notes = [f"pca over counting, both ours, clusters 2 M: {statistics.median(over_counting):.1f}"]
    notes += [f"pca, voxels of {name}, CPU seconds: ours {own:.2f}, theirs {statistics.median(cpu[name]):.2f}" for name in sizes]
    notes += [f"pca, voxels of {name}: {ellipsoid_difference(made, values[name], radius)}" for name in sizes]
    return list(rows.values()), notes


def ellipsoid_difference(made, path, radius):
    ours, theirs = np.load(made), np.fromfile(path).reshape(-1, 7)
    is_in, theirs_in = ours["ellipsoids"].astype(bool), theirs[:, 3] != 0
    both = is_in & theirs_in
    stretch = ours["stretch"][both].astype(np.float64)
    relative = (np.abs(theirs[both, :3] - stretch) / stretch).max(axis=1)
    moved = np.abs(theirs[:, 4:] - ours["pws"]).max(axis=1) / radius
    return (f"{np.count_nonzero(is_in != theirs_in)} of {len(is_in)} points differ in the group ({np.count_nonzero(both)} in both); "
            f"stretch, relative: median {np.median(relative):.1e}, largest {relative.max():.1e}, "
            f"{np.count_nonzero(relative > 1e-4)} above 1e-4; pws: largest {moved.max():.1e} radii, "
            f"{np.count_nonzero(moved > 1e-6)} above 1e-6")


def compare_density(ours, name, points, particle_radius):
    """POINTS: what both read, positions of float32."""
    radius = 4 * particle_radius
    mass = REST_DENSITY * (2 * particle_radius) ** 3
    made, surface = os.path.join(ours.folder, "density.npz"), os.path.join(ours.folder, "surface.ply")
    words = ("--attributes", "density", "--mass", repr(mass), "--attributes-output", made)
    row = Comparison(f"density by splashsurf, {name}")
    for _ in range(ROUNDS):
        seconds, _ = ours.search(points, radius, *words)
        row.add(0, seconds)
        # Cubes as large as a particle's radius: with half or twice that the two scopes take as long, within the noise.
        theirs = Program(os.path.join(os.path.dirname(sys.executable), "pysplashsurf"), "-v", "reconstruct", points, "-r",
                         particle_radius, "-l", 2.0, "-c", 1.0, "-n", THREADS, "-o", surface)
        scopes = dict(SCOPE.findall(theirs.text))
        row.add(1, sum(float(scopes[scope]) for scope in ("decomposition", "compute_global_density_vector")) / 1000)
    positions = os.path.join(ours.folder, "positions.npz")
    ours.run("convert", points, "-o", positions, "--keep", "none", "-f")
    particles = np.load(positions)["positions"]
    expected = np.load(made)["nns_density"].astype(np.float64)
    notes = []
    for kind in (np.float32, np.float64):
        done = pysplashsurf.reconstruct_surface(particles.astype(kind), particle_radius=particle_radius, smoothing_length=2.0,
                                                cube_size=1.0, rest_density=REST_DENSITY)
        relative = np.abs(np.asarray(done.particle_densities, np.float64) / expected - 1)
        notes.append(f"density, {name}, theirs in {kind.__name__}: largest relative difference {relative.max():.1e}")
    return row, notes


def compare_clusters(ours, points, radius):
    made, theirs_made = os.path.join(ours.folder, "clusters.npz"), os.path.join(ours.folder, "dbscan.npz")
    script = os.path.join(os.path.dirname(os.path.realpath(__file__)), "dbscan_peer.py")
    whole = Comparison("`fit` of scikit-learn's DBSCAN, dam_break 1 M; ours the whole command")
    alone = Comparison("the same; ours grid and pass")
    for _ in range(ROUNDS):
        seconds, run = ours.search(points, radius, "--attributes", "cluster,count", "--min-neighbors", MIN_NEIGHBORS,
                                   "--attributes-output", made)
        theirs = Program(sys.executable, script, points, radius, MIN_NEIGHBORS + 1, THREADS, theirs_made)
        for row, own in ((whole, run.seconds), (alone, seconds)):
            row.add(0, own, run.megabytes)
            row.add(1, float(theirs.last_line()), theirs.megabytes)
    return [whole, alone], [cluster_difference(made, theirs_made)]


def cluster_difference(made, theirs_made):
    ours, theirs = np.load(made), np.load(theirs_made)
    labels, core = ours["nns_cluster"], ours["nns_count"] >= MIN_NEIGHBORS
    theirs_core = theirs["core"]
    noise = np.count_nonzero((labels < 0) != (theirs["labels"] < 0))
    pairs = np.unique(np.stack([labels, theirs["labels"]])[:, core & theirs_core], axis=1)
    is_same = all(len(np.unique(side)) == pairs.shape[1] for side in pairs)
    rename = dict(zip(*pairs))
    border = ~core & (labels >= 0)
    moved = sum(rename.get(a) != b for a, b in zip(labels[border], theirs["labels"][border]))
    return (f"clusters: {np.count_nonzero(core != theirs_core)} points differ in being core points, {noise} in being noise; "
            f"{'the same' if is_same else 'not the same'} {pairs.shape[1]} clusters of {np.count_nonzero(core)} core points; "
            f"{moved} of {np.count_nonzero(border)} border points in another one")


def main():
    program, peer, frame, folder = sys.argv[1:]
    ours = Ours(program, folder)
    dam, radius = ours.scene("dam_break", "1M")
    points, as_ply = os.path.join(folder, "dam_break.npy"), os.path.join(folder, "dam_break.ply")
    ours.run("convert", dam, "-o", points, "--keep", "none", "-f")
    np.save(points, np.load(points).astype(np.float32))  # positions that all of them read the same
    ours.run("convert", points, "-o", as_ply, "-f")

    rows, notes = compare_ellipsoids(ours, peer)
    for name, path, particle_radius in (("frame", frame, 0.025), ("dam_break 1 M", as_ply, radius / 4)):
        row, more = compare_density(ours, name, path, particle_radius)
        rows.append(row)
        notes += more
    more_rows, more = compare_clusters(ours, points, radius)
    rows += more_rows
    notes += more

    print("| what | ours s | theirs s | ratio | ours MB | theirs MB |")
    print("|---|---|---|---|---|---|")
    for row in rows:
        print(row.row())
    print()
    for note in [*notes, f"load average of the last 15 minutes: {os.getloadavg()[2]:.1f}"]:
        print(f"* {note}")


if __name__ == "__main__":
    main()

#!/usr/bin/env python3
"""Draws the reports of `vdb_nns bench --json` as one self-contained HTML page, and each chart as SVG and PNG.

    tools/chart.py OUT.html BENCH.json [BENCH.json ...] [--images FOLDER]

Several reports are merged: several scenes, or the stability of one run beside the speed of another; of what
is there twice the last counts. OUT.html may be `-`, standard output. The same reports give the same bytes. Needs
Matplotlib (3.6 or later) and nothing else.

exit: 0 done · 2 a report that cannot be read or is none, or bad flags · 3 no Matplotlib · 6 something cannot
be written
"""

import argparse
import os
import sys

sys.dont_write_bytecode = True  # this folder may be an installed one
sys.path.insert(0, os.path.dirname(os.path.realpath(__file__)))

from charts import report as reports

BAD_INPUT, NO_MATPLOTLIB, NOT_WRITTEN = 2, 3, 6


def say(sentence):
    """Names and paths may hold what does something to a terminal."""
    visible = "".join(c if c.isprintable() else repr(c)[1:-1] for c in str(sentence))
    print(f"chart.py: {visible}", file=sys.stderr)


def fail(code, sentence):
    say(sentence)
    sys.exit(code)


def write(path, content):
    """Writes beside the target and renames, so that nobody reads a half page and a failure leaves the old
    one."""
    beside = f"{path}.{os.getpid()}.part"
    try:
        with open(beside, "wb") as file:
            file.write(content if isinstance(content, bytes) else content.encode("utf-8", "replace"))
        os.replace(beside, path)
    except OSError as error:
        if os.path.exists(beside):
            os.remove(beside)
        fail(NOT_WRITTEN, f"{path}: cannot be written: {error.strerror}")


def write_images(folder, charts):
    try:
        os.makedirs(folder, exist_ok=True)
    except OSError as error:
        fail(NOT_WRITTEN, f"{folder}: cannot be made: {error.strerror}")
    for chart in charts:
        write(os.path.join(folder, chart.name + ".svg"), chart.svg())
        write(os.path.join(folder, chart.name + ".png"), chart.png())


def main():
    parser = argparse.ArgumentParser(prog="chart.py", description=__doc__.split("\n", maxsplit=1)[0])
    parser.add_argument("output", metavar="OUT.html", help="the page to write")
    parser.add_argument("reports", metavar="BENCH.json", nargs="+", help="reports of vdb_nns bench --json")
    parser.add_argument(
        "--images", metavar="FOLDER", help="where to write each chart as NAME.svg and NAME.png as well"
    )
    options = parser.parse_args()
    try:
        report = reports.load(options.reports)
    except reports.BadReport as error:
        fail(BAD_INPUT, error)
    try:
        from charts import page
    except ImportError as error:
        if (error.name or "").startswith("charts"):
            raise
        fail(NO_MATPLOTLIB, "matplotlib is missing; install python3-matplotlib")
    for note in report.notes:
        say(note)
    html, charts = page.build(report)
    if options.images:
        write_images(options.images, charts)
    if options.output == "-":
        sys.stdout.buffer.write(html.encode("utf-8", "replace"))
    else:
        write(options.output, html)


if __name__ == "__main__":
    main()

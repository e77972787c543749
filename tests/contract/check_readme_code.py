"""Runs what the documents show: their `build/vdb_nns` and `tools/render.py` commands on a smaller scene, then their Python blocks on what they wrote.

    check_readme_code.py SOURCE_DIR VDB_NNS [VDB_NNS_EMULATED]

The commands that demand a GPU run with the program on an emulated one, where there is that.
"""

import os
import re
import subprocess
import sys
import tempfile

# In this order: the commands of README.md make the scene and the lists that the others use. As many as each page must have, so
# that a block that moves to a page that is not read here is missed.
PAGES = {  # page: (commands, Python blocks)
    "README.md": (6, 1),
    "docs/cli.md": (15, 0),
    "docs/measures.md": (11, 1),
    "docs/README.md": (2, 0),
    "docs/gpu.md": (3, 0),
    "docs/python.md": (0, 2),
}

source, program, *emulated = map(os.path.abspath, sys.argv[1:])
commands, snippets = [], []
for page, (fewest_commands, fewest_snippets) in PAGES.items():
    with open(os.path.join(source, page), encoding="utf-8") as file:
        blocks = re.findall(r"^```(\w+)\n(.*?)^```", file.read(), re.M | re.S)
    lines = [line for kind, text in blocks if kind == "sh" for line in text.splitlines()]
    of_page = [line for line in lines if line.startswith(("build/vdb_nns", "tools/render.py"))]
    snippets_of_page = [text for kind, text in blocks if kind == "python"]
    assert len(of_page) >= fewest_commands and len(snippets_of_page) >= fewest_snippets, (page, of_page, snippets_of_page)
    commands += of_page
    snippets += snippets_of_page

with tempfile.TemporaryDirectory() as folder:
    os.chdir(folder)
    for command in commands:
        needs_gpu = "--device cuda" in command
        if needs_gpu and not emulated:
            print("not run:", command)
            continue
        # All methods, and all repetitions, take minutes.
        command = command.replace("--stability", "--stability --method codec8").replace("--chart", "--repeat 1 --chart")
        command = command.replace("build/vdb_nns", f"'{emulated[0] if needs_gpu else program}'", 1).replace("1000000", "20000")
        command = re.sub("^tools/", f"'{sys.executable}' -B '{source}'/tools/", command)
        subprocess.run(command, shell=True, check=True, stdout=subprocess.DEVNULL)
    names = {}
    for snippet in snippets:
        exec(snippet, names)
    lists = names["lists"]
    assert (lists.indptr == names["indptr"]).all() and (lists.indices == names["indices"]).all()
    assert len(names["neighbors_of_7"]) == lists.indptr[8] - lists.indptr[7]
    assert lists.nnz > 20000, "a scene of 20000 particles has more pairs than particles"
print(f"{len(commands)} commands and {len(snippets)} Python blocks of {', '.join(PAGES)} work")

#!/usr/bin/env bash
# Writes the flag table and the example of README.md again: tools/readme.sh [build/vdb_nns]
set -euo pipefail
cd "$(dirname "${BASH_SOURCE[0]}")/.."
program=${1:-build/vdb_nns}
/usr/bin/python3 - "$program" <<'PYTHON'
import subprocess, sys

def put(text, begin, end, body):
    head, rest = text.split(begin, 1)
    return head + begin + "\n" + body.strip() + "\n" + end + rest.split(end, 1)[1]

readme = open("README.md").read()
table = subprocess.run([sys.argv[1], "--help-markdown"], check=True, capture_output=True, text=True).stdout
readme = put(readme, "<!-- vdb_nns --help-markdown -->", "<!-- end of --help-markdown -->", table)
sample = open("samples/readme_example.cpp").read()
readme = put(readme, "<!-- samples/readme_example.cpp -->\n```cpp", "```\n<!-- end of the example -->", sample)
open("README.md", "w").write(readme)
PYTHON
echo "README.md is up to date"

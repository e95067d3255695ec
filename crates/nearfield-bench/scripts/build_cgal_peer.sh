#!/bin/sh
# Builds the CGAL program that `nearfield-bench wlop --cgal PROGRAM` compares samples with:
#
#   crates/nearfield-bench/scripts/build_cgal_peer.sh [PROGRAM]
#
# PROGRAM is target/cgal_peer by default. Needs a C++ compiler and CGAL 5.5 (Debian: libcgal-dev); without them it says so
# and ends with 0, as the comparison is one that may be left out. CXXFLAGS and LDFLAGS are taken over.
set -eu
here=$(cd "$(dirname "$0")" && pwd)
program=${1:-target/cgal_peer}
compiler=${CXX:-c++}
if ! command -v "$compiler" > /dev/null; then
    echo "skipped: no C++ compiler ($compiler); CGAL is left out"
    exit 0
fi
if ! printf '#include <CGAL/version.h>\n' | "$compiler" ${CXXFLAGS:-} -x c++ -fsyntax-only - 2> /dev/null; then
    echo "skipped: no CGAL/version.h (Debian: apt-get install libcgal-dev); CGAL is left out"
    exit 0
fi
mkdir -p "$(dirname "$program")"
"$compiler" -O3 -DNDEBUG -std=c++17 ${CXXFLAGS:-} "$here/cgal_peer.cpp" ${LDFLAGS:-} -lgmp -lmpfr -o "$program"
echo "built: $program"

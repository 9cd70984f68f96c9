#!/bin/sh
# Fetch the live page's plot library as package.json pins it, check it, and copy it into src/leadline/page/vendor.
set -eu
page=$(cd "$(dirname "$0")/../src/leadline/page" && pwd)
version=$(sed -n 's/.*"uplot": "\([0-9.]*\)".*/\1/p' "$page/package.json")
sha256=4b8a8191e425658e3ea8c8c1314b0fc679c861ee3a1af2b20c7b16ba50b5133d # of uplot-1.6.32.tgz
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
cd "$work"
npm pack --silent "uplot@$version"
echo "$sha256  uplot-$version.tgz" | sha256sum --check --quiet
tar xzf "uplot-$version.tgz"
cp package/dist/uPlot.esm.js "$page/vendor/uPlot.js"
cp package/dist/uPlot.min.css "$page/vendor/uPlot.css"
cp package/LICENSE "$page/vendor/uPlot.LICENSE"

#!/bin/sh
# Builds the Debian packages rfsm and lua-rfsm of the last commit, and lets lintian judge
# them:  tools/packaging/deb.sh FOLDER
set -eu
folder=$1
version=$(sed -n 's/.*_VERSION = "rfsm \(.*\)".*/\1/p' rfsm.lua)
tree=$folder/rfsm-$version

mkdir -p "$folder"
rm -rf "$tree"
git archive --prefix="rfsm-$version/" HEAD | tar -x -C "$folder"
cp -r "$tree/tools/packaging/debian" "$tree/debian"
sed '1,2d; s/^$/./; s/^/ /' LICENSE >>"$tree/debian/copyright"
cat >"$tree/debian/changelog" <<END
rfsm ($version) unstable; urgency=medium

  * Release $version; see CHANGELOG.md.

 -- The rfsm authors <rfsm@example.org>  $(git log -1 --format=%aD)
END

cd "$tree"
dpkg-buildpackage --no-sign
lintian --fail-on error,warning "../rfsm_${version}_$(dpkg --print-architecture).changes"

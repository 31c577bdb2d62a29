#!/bin/sh
# Builds the rock of the last commit from a tarball and installs it for each version of
# Lua, then runs `luarocks test` on SPEC:  tools/packaging/rocks.sh FOLDER
#
# No rock comes from elsewhere: the packages of Debian are given to LuaRocks as rocks.
set -eu
folder=$1 top=$PWD
version=$(sed -n 's/.*_VERSION = "rfsm \(.*\)".*/\1/p' rfsm.lua)
mkdir -p "$folder"
folder=$(cd "$folder" && pwd)

git archive --prefix="rfsm-$version/" -o "$folder/rfsm-$version.tar.gz" HEAD
lua5.1 tools/rockspec.lua "$version" "file://$folder/rfsm-$version.tar.gz" \
  >"$folder/rfsm-$version-1.rockspec"

cat >"$folder/config.lua" <<END
rocks_servers, rocks_provided = {}, { luacheck = "1.0-1" }
rocks_trees = { { name = "last", root = "$folder/5.4" } }
END
export LUAROCKS_CONFIG="$folder/config.lua"
printf '#!/bin/sh\nexec /usr/bin/busted --lua="$(command -v lua5.1)" "$@"\n' \
  >"$folder/busted.sh"
cat >"$folder/busted-2.0-1.rockspec" <<'END'
package, version, source = "busted", "2.0-1", { url = "." }
build = { type = "builtin", modules = {}, install = { bin = { busted = "busted.sh" } } }
END

for lua in 5.1 5.2 5.3 5.4; do
  cd "$folder" # not in the sources: what is run below is what was installed
  rocks="luarocks --lua-version=$lua --tree=$folder/$lua"
  $rocks build --deps-mode none "rfsm-$version-1.rockspec" >/dev/null
  for name in "lua$lua" $([ $lua = 5.1 ] && echo luajit); do
    LUA=$name "$folder/$lua/bin/rfsm" check "$top/examples/hello_world.lua" >/dev/null
    echo "rfsm-$version-1: installed, $name runs it"
  done
done
$rocks make --deps-mode none busted-2.0-1.rockspec >/dev/null
cd "$top"
$rocks test rockspec/rfsm-dev-1.rockspec -- ${SPEC:-spec/machine_spec.lua}

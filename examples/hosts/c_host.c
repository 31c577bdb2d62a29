/* A host in C, for Lua 5.1 to 5.4: walks a machine's tables, replaces a callback, and
 * drives the machine two steps at a time. At the top of the checkout:
 *   cc examples/hosts/c_host.c $(pkg-config --cflags --libs lua5.4) -o c_host && ./c_host
 */
#include <stdio.h>
#include <lua.h>
#include <lauxlib.h>
#include <lualib.h>

static const char *CHART =
  "package.path = './?.lua;' .. package.path\n"
  "rfsm = require 'rfsm'\n"
  "local function work() for i = 1, 5 do rfsm.yield() end end\n"
  "return rfsm.init(rfsm.state { info = false, warn = false,\n"
  "  off = rfsm.state {}, on = rfsm.state { bright = rfsm.state { doo = work },\n"
  "    rfsm.trans { src = 'initial', tgt = 'bright' } },\n"
  "  rfsm.trans { src = 'initial', tgt = 'off' },\n"
  "  rfsm.trans { src = 'off', tgt = 'on', events = 'e_push' } })\n";

static int entered(lua_State *L) { /* entry(fsm, state, "entry") */
  lua_getfield(L, 2, "_fqn");
  return printf("entered %s\n", lua_tostring(L, -1)), 0;
}

/* Counts the states: a text key without an underscore, and a table with a _mode. */
static int walk(lua_State *L, int state) {
  int states = 0;
  for (lua_pushnil(L); lua_next(L, state) != 0; lua_pop(L, 1)) {
    if (lua_type(L, -2) != LUA_TSTRING || lua_tostring(L, -2)[0] == '_'
      || !lua_istable(L, -1)) continue;
    lua_getfield(L, -1, "_mode"); /* connectors have none */
    if (lua_isstring(L, -1)) states += 1 + walk(L, lua_gettop(L) - 1);
    lua_pop(L, 1);
  }
  return states;
}

/* Replaces the value on top by rfsm.NAME(fsm, value). */
static void call(lua_State *L, const char *name) {
  lua_getglobal(L, "rfsm"), lua_getfield(L, -1, name), lua_remove(L, -2);
  lua_insert(L, -2), lua_pushvalue(L, 1), lua_insert(L, -2);
  if (lua_pcall(L, 2, 1, 0)) printf("error: %s\n", lua_tostring(L, -1));
}

int main(void) {
  int turns = 0;
  lua_State *L = luaL_newstate();
  luaL_openlibs(L);
  if (luaL_dostring(L, CHART)) return fprintf(stderr, "%s\n", lua_tostring(L, -1)), 1;
  printf("%d states\n", walk(L, 1));
  lua_getfield(L, 1, "on");
  lua_pushcfunction(L, entered), lua_setfield(L, -2, "entry");
  lua_pushnil(L), call(L, "run");
  lua_pushstring(L, "e_push"), call(L, "send_events");
  do { /* a turn of a host that has other things to do */
    lua_pushinteger(L, 2), call(L, "step"), turns++;
  } while (!lua_toboolean(L, -1));
  lua_pushnil(L), call(L, "get_actleaf_fqn");
  return printf("active: %s after %d turns\n", lua_tostring(L, -1), turns), 0;
}

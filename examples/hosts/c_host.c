/* A host in C: loads the core, makes a machine, walks its tables, drives it, and replaces
 * a callback. For Lua 5.1 to 5.4:
 *
 *   cc examples/hosts/c_host.c $(pkg-config --cflags --libs lua5.4) -o c_host && ./c_host
 *
 * It runs at the top of the checkout. */

#include <stdio.h>
#include <lua.h>
#include <lauxlib.h>
#include <lualib.h>

#if LUA_VERSION_NUM == 501
#define lua_rawlen lua_objlen
#endif

static const char *CHART =
  "package.path = './?.lua;' .. package.path\n"
  "local rfsm = require 'rfsm'\n"
  "return rfsm.init(rfsm.state { info = false, warn = false,\n"
  "  off = rfsm.state {}, on = rfsm.state { bright = rfsm.state {},\n"
  "    rfsm.trans { src = 'initial', tgt = 'bright' } },\n"
  "  rfsm.trans { src = 'initial', tgt = 'off' },\n"
  "  rfsm.trans { src = 'off', tgt = 'on', events = 'e_push' } })\n";

/* Calls rfsm.NAME(fsm[, event]); the machine is at index 1. */
static void call(lua_State *L, const char *name, const char *event) {
  lua_getglobal(L, "require");
  lua_pushstring(L, "rfsm");
  lua_call(L, 1, 1);
  lua_getfield(L, -1, name);
  lua_pushvalue(L, 1);
  if (event) lua_pushstring(L, event);
  lua_call(L, event ? 2 : 1, 1);
}

static int entered(lua_State *L) { /* entry(fsm, state, "entry") */
  lua_getfield(L, 2, "_fqn");
  printf("entered %s\n", lua_tostring(L, -1));
  return 0;
}

/* Prints the states, which stand under their names; all other text keys of a state that
 * is not the user's begin with an underscore or are the fields of a model. */
static int walk(lua_State *L, int state) {
  int states = 0;
  for (lua_pushnil(L); lua_next(L, state) != 0; lua_pop(L, 1)) {
    if (lua_type(L, -2) != LUA_TSTRING || lua_tostring(L, -2)[0] == '_'
      || !lua_istable(L, -1)) continue;
    lua_pushstring(L, "_mode"); /* states have one, connectors have not */
    lua_rawget(L, -2);
    if (lua_isstring(L, -1)) states += 1 + walk(L, lua_gettop(L) - 1);
    lua_pop(L, 1);
  }
  return states;
}

int main(void) {
  lua_State *L = luaL_newstate();
  luaL_openlibs(L);
  if (luaL_dostring(L, CHART)) return fprintf(stderr, "%s\n", lua_tostring(L, -1)), 1;
  printf("%d states, %d transitions\n", walk(L, 1), (int)lua_rawlen(L, 1));
  lua_rawgeti(L, 1, 2); /* a transition by its number */
  lua_getfield(L, -1, "src");
  lua_getfield(L, -1, "_fqn");
  printf("transition 2 leaves %s\n", lua_tostring(L, -1));
  lua_getfield(L, 1, "on"); /* a state by its name */
  lua_pushcfunction(L, entered);
  lua_setfield(L, -2, "entry");
  call(L, "run", NULL);
  call(L, "send_events", "e_push");
  call(L, "run", NULL);
  call(L, "get_actleaf_fqn", NULL);
  printf("active: %s\n", lua_tostring(L, -1));
  lua_close(L);
  return 0;
}

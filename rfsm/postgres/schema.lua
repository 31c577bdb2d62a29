--- The schema `rfsm`: tables, and functions in SQL around the one in PL/Lua.
--
-- What is there already stays; functions are replaced. No table is locked that is as it
-- should be, so a load and the clients do not wait for each other. $TAG, $CODE, $ID,
-- $HISTORY and $NOTIFY are texts that `rfsm.postgres.script` puts in.
--
-- @module rfsm.postgres.schema
-- @license BSD-3-Clause

local schema = {}

schema.HEAD = [[
-- Made by: rfsm postgres. All of it, or nothing: one transaction.
BEGIN;
SET LOCAL client_min_messages = warning;
CREATE SCHEMA IF NOT EXISTS rfsm;

CREATE TABLE IF NOT EXISTS rfsm.machines (
  key text COLLATE "C" PRIMARY KEY,
  chart text COLLATE "C" NOT NULL,
  version text NOT NULL,        -- fingerprint of the structure of the chart
  state text COLLATE "C" NOT NULL, -- FQN of the active leaf
  mode text NOT NULL,           -- active, done, inactive
  since timestamptz NOT NULL,   -- when it came to the state
  event text NOT NULL,          -- by which it came
  due timestamptz,              -- when it is to be woken
  data jsonb NOT NULL,          -- what the chart keeps, by state
  value jsonb NOT NULL          -- snapshot, ids of the latest events, events to come
) WITH (fillfactor = 80);

-- What machines have emitted, for workers to do and delete.
CREATE TABLE IF NOT EXISTS rfsm.out (
  id bigint GENERATED ALWAYS AS IDENTITY PRIMARY KEY,
  at timestamptz NOT NULL DEFAULT clock_timestamp(),
  key text COLLATE "C" NOT NULL,
  what text NOT NULL,
  data jsonb
);

-- Errors of callbacks, and of machines that could not be woken.
CREATE TABLE IF NOT EXISTS rfsm.log (
  id bigint GENERATED ALWAYS AS IDENTITY PRIMARY KEY,
  at timestamptz NOT NULL DEFAULT clock_timestamp(),
  key text COLLATE "C" NOT NULL,
  error text NOT NULL
);

-- CREATE INDEX IF NOT EXISTS locks the table before it looks.
DO $$ BEGIN
  IF to_regclass('rfsm.log_key') IS NULL THEN
    CREATE INDEX machines_state ON rfsm.machines (chart, state, since);
    CREATE INDEX machines_due ON rfsm.machines (due) WHERE due IS NOT NULL;
    CREATE INDEX log_key ON rfsm.log (key, id);
  END IF;
END $$;

-- Is a state another one, or in it?
CREATE OR REPLACE FUNCTION rfsm.is_in(state text, other text)
  RETURNS boolean LANGUAGE sql IMMUTABLE AS $$
  SELECT state = other OR starts_with(state, other || '.')
$$;
]]

schema.FUNCTIONS = [[

CREATE EXTENSION IF NOT EXISTS pllua;

CREATE OR REPLACE FUNCTION rfsm.call(name text, key text, args text[], id text)
  RETURNS text[] LANGUAGE pllua AS $TAG
  return self.answer(name, key, args, id)
end
do
$CODE$TAG;
COMMENT ON FUNCTION rfsm.call IS 'library $ID';

CREATE OR REPLACE FUNCTION rfsm.create(key text, chart text, data jsonb DEFAULT '{}',
  id text DEFAULT NULL) RETURNS text LANGUAGE sql AS $$
  SELECT (rfsm.call('rfsm_create', key, ARRAY[chart, coalesce(data, '{}')::text],
    id))[1]
$$;

CREATE OR REPLACE FUNCTION rfsm.send(key text, events text[], id text DEFAULT NULL)
  RETURNS text LANGUAGE sql AS $$
  SELECT (rfsm.call('rfsm_send', key, events, id))[1]
$$;

CREATE OR REPLACE FUNCTION rfsm.send(key text, event text, id text DEFAULT NULL)
  RETURNS text LANGUAGE sql AS $$
  SELECT (rfsm.call('rfsm_send', key, ARRAY[event], id))[1]
$$;

CREATE OR REPLACE FUNCTION rfsm.reply(key text, events text[], id text DEFAULT NULL,
  OUT state text, OUT mode text, OUT errors text[], OUT outcome text) LANGUAGE sql AS $$
  SELECT r[1], r[2], r[3:cardinality(r) - 1], r[cardinality(r)]
  FROM rfsm.call('rfsm_send', key, events, id) r
$$;

CREATE OR REPLACE FUNCTION rfsm.send_at(key text, at timestamptz, event text, id text)
  RETURNS text LANGUAGE sql AS $$
  SELECT (rfsm.call('rfsm_send_at', key, ARRAY[extract(epoch FROM at)::text, event],
    id))[1]
$$;

CREATE OR REPLACE FUNCTION rfsm.cancel(key text, id text)
  RETURNS boolean LANGUAGE sql AS $$
  SELECT (rfsm.call('rfsm_cancel', key, ARRAY[id], NULL))[1] = '1'
$$;

CREATE OR REPLACE FUNCTION rfsm.tick(key text) RETURNS text LANGUAGE sql AS $$
  SELECT (rfsm.call('rfsm_tick', key, NULL, NULL))[1]
$$;

CREATE OR REPLACE FUNCTION rfsm.why(key text, event text)
  RETURNS SETOF text LANGUAGE sql AS $$
  SELECT unnest(rfsm.call('rfsm_why', key, ARRAY[event], NULL))
$$;

-- Runs machines that are due and that no other worker has; returns how many. One that
-- cannot run waits for a minute, and the log has the reason.
CREATE OR REPLACE FUNCTION rfsm.wake(most integer DEFAULT 100)
  RETURNS integer LANGUAGE plpgsql AS $$
DECLARE
  each text;
  woken integer := 0;
BEGIN
  FOREACH each IN ARRAY ARRAY(SELECT m.key FROM rfsm.machines m WHERE m.due <= now()
    ORDER BY m.due LIMIT most FOR UPDATE SKIP LOCKED)
  LOOP
    BEGIN
      PERFORM rfsm.tick(each);
      woken := woken + 1;
    EXCEPTION WHEN OTHERS THEN
      UPDATE rfsm.machines SET due = now() + interval '1 minute' WHERE key = each;
      INSERT INTO rfsm.log (key, error) VALUES (each, SQLERRM);
    END;
  END LOOP;
  RETURN woken;
END $$;

-- A worker that wakes machines until it is cancelled, each batch in a transaction.
CREATE OR REPLACE PROCEDURE rfsm.work(pause double precision DEFAULT 0.1)
  LANGUAGE plpgsql AS $$
BEGIN
  LOOP
    IF rfsm.wake() = 0 THEN
      COMMIT;
      PERFORM pg_sleep(pause);
    END IF;
    COMMIT;
  END LOOP;
END $$;
]]

schema.HISTORY = [[

CREATE TABLE IF NOT EXISTS rfsm.history (
  id bigint GENERATED ALWAYS AS IDENTITY PRIMARY KEY,
  at timestamptz NOT NULL DEFAULT clock_timestamp(),
  key text COLLATE "C" NOT NULL,
  event text,
  src text COLLATE "C",         -- NULL: the machine is new
  tgt text COLLATE "C"          -- NULL: the machine was deleted
);
DO $$ BEGIN
  IF to_regclass('rfsm.history_key') IS NULL THEN
    CREATE INDEX history_key ON rfsm.history (key, id);
  END IF;
END $$;

CREATE OR REPLACE FUNCTION rfsm.note() RETURNS trigger LANGUAGE plpgsql AS $$
BEGIN
  IF TG_OP = 'DELETE' THEN
    INSERT INTO rfsm.history (key, src) VALUES (OLD.key, OLD.state);
  ELSIF TG_OP = 'INSERT' THEN
    INSERT INTO rfsm.history (key, event, tgt) VALUES (NEW.key, NEW.event, NEW.state);
  ELSE
    INSERT INTO rfsm.history (key, event, src, tgt)
      VALUES (NEW.key, NEW.event, OLD.state, NEW.state);
  END IF;
  RETURN NULL;
END $$;
]]

schema.NOTIFY = [[

CREATE OR REPLACE FUNCTION rfsm.notify() RETURNS trigger LANGUAGE plpgsql AS $$
BEGIN
  PERFORM pg_notify('rfsm', json_build_object('key', NEW.key, 'chart', NEW.chart,
    'state', NEW.state)::text);
  RETURN NULL;
END $$;
]]

schema.TRIGGERS = [[

-- Makes the triggers that are absent or different, and drops those that are not wanted.
-- Either takes a lock that waits for clients, and for which clients wait.
DO $$
DECLARE
  moved text := 'WHEN ((old.state <> new.state)) ';
  each record;
BEGIN
  FOR each IN
    SELECT name, replace(pg_get_triggerdef(t.oid), 'FUNCTION n',
      'FUNCTION rfsm.n') AS found, -- it lacks a schema that is in search_path
      CASE WHEN is_wanted THEN format('CREATE TRIGGER %s AFTER %s ON rfsm.machines '
        'FOR EACH ROW %sEXECUTE FUNCTION rfsm.%s()', name, event, condition, f)
      END AS wanted
    FROM (VALUES ('note_new', 'INSERT OR DELETE', '', 'note', $HISTORY),
      ('note_move', 'UPDATE', moved, 'note', $HISTORY),
      ('notify_new', 'INSERT', '', 'notify', $NOTIFY),
      ('notify_move', 'UPDATE', moved, 'notify', $NOTIFY))
      AS ours (name, event, condition, f, is_wanted)
    LEFT JOIN pg_trigger t ON tgrelid = 'rfsm.machines'::regclass AND tgname = name
  LOOP
    CONTINUE WHEN each.found IS NOT DISTINCT FROM each.wanted;
    EXECUTE format('DROP TRIGGER IF EXISTS %s ON rfsm.machines', each.name);
    IF each.wanted IS NOT NULL THEN EXECUTE each.wanted; END IF;
  END LOOP;
END $$;
]]

schema.FOOT = "\nCOMMIT;\n"

return schema

-- A warehouse at work in PostgreSQL:  psql -v orders=12 -f examples/warehouse/postgres.sql
--
-- Takes orders, and is a worker that does what they emit, and that wakes them: what
-- run.lua does in Redis. Any number of such workers may run.

-- Take orders; each fourth is never paid.
SELECT rfsm.create('order:' || i, 'order', jsonb_build_object('item',
  (ARRAY['bolts', 'nuts', 'gears'])[i % 3 + 1])) AS state
FROM generate_series(1, :orders) AS i \g /dev/null
SELECT rfsm.send('order:' || i, 'e_paid') AS state
FROM generate_series(1, :orders) AS i WHERE i % 4 <> 0 \g /dev/null

DO $$
DECLARE
  entry record;
  answer text;
BEGIN
  LOOP
    SELECT * INTO entry FROM rfsm.take();
    COMMIT;
    IF entry.id IS NOT NULL THEN
      -- What a picker or a packer does. The shelf with gears is empty at first.
      answer := CASE WHEN entry.what = 'pack' THEN 'e_packed'
        WHEN entry.data @> '{"item": "gears", "try": 1}' THEN 'e_empty'
        ELSE 'e_picked' END;
      IF (rfsm.reply(entry.key, ARRAY[answer], 'out-' || entry.id)).outcome
        = 'dropped' THEN
        PERFORM rfsm.fail(entry.id, answer || ' was dropped');
      ELSE
        PERFORM rfsm.done(entry.id);
      END IF;
      RAISE INFO '% % % -> %', entry.key, entry.what, entry.data->>'item', answer;
    ELSIF rfsm.wake() = 0 THEN
      EXIT WHEN NOT EXISTS (SELECT FROM rfsm.machines
        WHERE state NOT IN ('root.shipped', 'root.cancelled'));
      COMMIT;
      PERFORM pg_sleep(0.1);
    END IF;
    COMMIT;
  END LOOP;
END $$;

SELECT count(*) FILTER (WHERE state = 'root.shipped') || ' shipped, '
  || count(*) FILTER (WHERE state = 'root.cancelled') || ' cancelled'
FROM rfsm.machines;

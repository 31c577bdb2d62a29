#!/bin/sh
# The help of $TOOL as help2man reads it: the usage and each option in one line, and the
# tool under its own name.
[ "$1" = --version ] && exec echo "$TOOL $(tools/rfsm --version | sed 's/.* //')"
tools/"$TOOL" --help | awk -v tool="$TOOL" '
  sub(/^Usage: rfsm( [a-z]+)?/, "Usage: " tool) { is_usage = 1; printf "%s", $0; next }
  is_usage && /^ / { sub(/^ +/, " "); printf "%s", $0; next }
  is_usage { is_usage = 0; print "" }
  /^ +-[a-z] [A-Z]+, / { # what follows describes both
    sub(/^ +/, ""); short = $1 " " $2; sub(/^-[a-z] [A-Z]+, +/, ""); about = $0; next
  }
  short { sub(/^ +/, ""); print "   " short " " $0 "  " about; short = ""; next }
  { print }'

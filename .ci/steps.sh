# Sourced by .ci/run and .ci/nightly: runs steps one after the other and prints the minutes of each at the end.
export place
place=$(mktemp -d)
began=$SECONDS
steps=()

step() { # NAME COMMAND ..: runs a command or a function, for as long as the whole run may still take
  local at=$SECONDS left=$((most_minutes * 60 - SECONDS + began)) code=0
  echo "+ $1: ${*:2}"
  export -f $(declare -F | awk '{ print $3 }')
  timeout -k 30 "$left" bash -euo pipefail -c '"$@"' step "${@:2}" || code=$?
  steps+=("$(minutes $((SECONDS - at)))  $1")
  [ "$code" -ne 124 ] || echo "$1: stopped, the whole run may take $most_minutes minutes" >&2
  [ "$code" -eq 0 ] || { echo "$1: failed with exit code $code" >&2; exit 1; }
}

minutes() { awk -v s="$1" 'BEGIN { printf "%6.1f min", s / 60 }'; }

ended() { # EXIT CODE: minutes by step, and the last line
  local total=$((SECONDS - began)) note=""
  rm -rf "$place"
  [ ${#steps[@]} -eq 0 ] || printf '%s\n' "${steps[@]}"
  [ "$total" -le $((usual_minutes * 60)) ] || note=", more than the $usual_minutes that it may usually take"
  [ "$1" -eq 0 ] || note="$note, FAILED"
  echo "$(minutes "$total")  in all$note"
}
trap 'ended $?' EXIT

test_line() { # README's line that installs bayesid and runs its tests
  local line
  line=$(sed -n 's/^    \(python3 -m venv .*pytest.*\)$/\1/p' README.md)
  [ -n "$line" ] && [ "$(printf '%s\n' "$line" | wc -l)" -eq 1 ] || { echo "README holds no single test line" >&2; return 1; }
  printf '%s\n' "$line"
}

types() { # The studies are a part of the package that lies beside it: both are checked as they are installed.
  mkdir -p "$place/types/bayesid"
  ln -sfn "$PWD"/bayesid/* "$PWD/studies" "$place/types/bayesid"
  .venv/bin/mypy --config-file pyproject.toml "$place/types/bayesid"
}

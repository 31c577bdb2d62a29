--- Returns the function `run` of a claim about random charts. `compare(seed, list)`
--- appends what is wrong, and returns whether the chart was compared.
return function(compare)
  --- Tries the charts of so many seeds. Returns how many were compared, and what is
  --- wrong.
  return function(n, seed)
    local list, compared = {}, 0
    for i = seed or 1, (seed or 1) + n - 1 do
      if compare(i, list) then compared = compared + 1 end
    end
    table.sort(list)
    return compared, list[1] and table.concat(list, "\n") or nil
  end
end

function [alpha, beta, code] = jaxstab_clamp(atlas, alpha, beta, gamma, delta, delay)
% Gains that a jaxstab atlas proves stable, none larger than those wanted; Octave 6, MATLAB R2016b.
%
%   atlas = jaxstab_query('atlas.h5')
%   [alpha, beta, code] = jaxstab_clamp(atlas, alpha, beta, gamma, delta, delay)
%       lowers gains of points, arrays of one shape or scalars, to those of walls that are proved
%       stable. Walls that are stay as they are. Codes:
%         1 stable, proved,
%         3 no wall of smaller gains is proved stable: both gains are 0,
%        -1 the atlas says nothing, or a gain is negative, infinite or NaN: both gains are 0.
%
% Where alpha is too large for beta, beta is lowered until alpha is granted; if no smaller beta
% grants it, the wall becomes the stiffest one that is found at an edge of a cell of the atlas. The
% answers are those of Python's Atlas.clamp.
  none = zeros(size(alpha + beta + gamma + delta + delay));
  shape = size(none);
  spread = @(values) reshape(values + none, 1, []);
  [alpha, beta] = deal(spread(alpha), spread(beta));
  plant = {spread(gamma), spread(delta), spread(delay)};
  code = -ones(1, numel(alpha));
  left = zeros(2, numel(alpha));
  cells = zeros(1, numel(alpha));
  for k = 1:size(atlas.range, 1)
    cells = cells + (plant{3} >= atlas.range(k, 1));
  end
  for k = unique(cells(cells > 0))
    ends = atlas.range(k, :);
    here = find(cells == k & plant{3} <= ends(2) & ...
                plant{1} >= atlas.gamma(1) & plant{1} <= atlas.gamma(end) & ...
                plant{2} >= atlas.delta(1) & plant{2} <= atlas.delta(end) & ...
                alpha >= max(ends(3), 0) & alpha < Inf & beta >= max(ends(5), 0) & beta < Inf);
    some = cellfun(@(values) values(here), plant, 'UniformOutput', false);
    [best, best_beta] = lowered(atlas, ends, alpha(here), beta(here), some);
    is_proved = best >= 0;
    left(1, here(is_proved)) = best(is_proved);
    left(2, here(is_proved)) = best_beta(is_proved);
    code(here) = 3 - 2 * is_proved;
  end
  alpha = reshape(left(1, :), shape);
  beta = reshape(left(2, :), shape);
  code = reshape(code, shape);
end

function [best, best_beta] = lowered(atlas, ends, alpha, beta, plant)
% The gains that are left, alpha -1 for none: cells along beta are passed downwards.
  aside = 2^-44;
  wanted = min(alpha, ends(4));
  high = beta;
  high(beta > ends(6)) = ends(6) * (1 - aside);
  per_beta = atlas.cells(1) / (ends(6) - ends(5));
  row = min(floor((high - ends(5)) * per_beta), atlas.cells(1) - 1);
  best = -ones(size(alpha));
  best_beta = zeros(size(alpha));
  here = 1:numel(alpha);
  while ~isempty(here)
    some = cellfun(@(values) values(here), plant, 'UniformOutput', false);
    [goal, top] = deal(wanted(here), high(here));
    edge = ends(5) + row(here) / per_beta;
    low = min(max(edge, 0) * (1 + aside), top);
    [at_high, above] = proved(atlas, goal, top, some, ends);
    [at_low, below] = proved(atlas, goal, low, some, ends);
    better = at_high > best(here);
    best(here(better)) = at_high(better);
    best_beta(here(better)) = top(better);
    better = at_low > best(here);
    best(here(better)) = at_low(better);
    best_beta(here(better)) = low(better);
    crossed = find(at_low == goal & at_high ~= goal);
    if ~isempty(crossed)
      share = (below - (goal + 2^-30 * goal)) ./ (below - above);
      middle = min(low + share .* (top - low), top);
      crossed = crossed(middle(crossed) > low(crossed));
      some = cellfun(@(values) values(crossed), some, 'UniformOutput', false);
      granted = proved(atlas, goal(crossed), middle(crossed), some, ends) == goal(crossed);
      best_beta(here(crossed(granted))) = middle(crossed(granted));
    end
    further = best(here) ~= goal & row(here) > 0 & edge > 0;
    here = here(further);
    high(here) = edge(further) * (1 - aside);
    row(here) = row(here) - 1;
  end
end

function [alpha, top] = proved(atlas, wanted, beta, plant, ends)
% The largest alphas up to wanted ones that are proved stable, -1 for none, and the limits.
  [~, ~, ~, ~, ~, from, top] = jaxstab_query(atlas, wanted, beta, plant{:});
  alpha = top - abs(top) * eps;
  is_wanted = wanted < top;
  alpha(is_wanted) = wanted(is_wanted);
  holds = alpha >= max(ends(3), 0) & alpha < top & alpha > from;
  alpha(~holds) = -1;
end

function [code, lower, lower_error, upper, upper_error] = ...
    jaxstab_query(atlas, alpha, beta, gamma, delta, delay)
% Stability verdicts from a jaxstab atlas, in Octave 6 or MATLAB R2016b and newer.
%
%   atlas = jaxstab_query('atlas.h5')
%       checks the file, its SHA-256 included, and loads the limits of the stable alpha. The
%       answers are for walls that take velocity and position as atlas.filters says, in words.
%
%   code = jaxstab_query(atlas, alpha, beta, gamma, delta, delay)
%       answers for points, arrays of one shape or scalars:
%         1 stable, 2 unstable (both proved), 3 undecided: too close to the boundary for the atlas,
%        -1 NaN, outside of the atlas, or between its delays: it says nothing. Beyond axes that hold
%           all stable walls the code is 2.
%
%   [code, lower, lower_error, upper, upper_error] = jaxstab_query(...)
%       gives the limits of the stable alpha too, which do not depend on the alpha asked about.
%       Of the alphas of the atlas every one from lower + lower_error to upper - upper_error is
%       stable, and every one below lower - lower_error or above upper + upper_error unstable. Where
%       none is stable both are NaN with an error of 0; an infinite limit is beyond the atlas, and
%       with an infinite error nothing is known.
%
% With K, B stiffness and damping of the virtual wall, m, b, k mass, damping and stiffness of device
% and hand, T sampling period and t_d delay:
%
%   alpha = K T^2/m    beta = B T/m    gamma = k T^2/m    delta = b T/m    delay = t_d/T
%
% The answers are those of Python's Atlas.verdict and Atlas.alpha_limits. data/README.md describes
% the file.
  if nargin == 1
    code = opened(atlas);
    return
  elseif nargin ~= 6
    error('jaxstab:usage', 'give a file, or an atlas and alpha, beta, gamma, delta and delay.');
  end
  none = zeros(size(alpha + beta + gamma + delta + delay));
  alpha = alpha + none;
  point = {beta + none, gamma + none, delta + none};
  delay = delay + none;

  code = none - 1;
  lower = NaN(size(none));
  lower_error = Inf(size(none));
  upper = lower;
  upper_error = lower_error;
  cells = zeros(size(delay));
  for k = 1:size(atlas.range, 1)
    cells = cells + (delay >= atlas.range(k, 1));
  end
  for k = unique(reshape(cells(cells > 0), 1, []))
    ends = atlas.range(k, :);
    here = find(cells == k & delay <= ends(2) & is_inside(point{1}, ends(5:6)) & ...
                is_inside(point{2}, atlas.gamma) & is_inside(point{3}, atlas.delta));
    at = cellfun(@(values) reshape(values(here), 1, []), [point, {delay}], ...
                 'UniformOutput', false);
    columns = double(atlas.limits(:, k, cells_of(atlas, ends(5:6), at{1:3})));
    [low, low_error] = limit_of(columns(1:10, :), at{:});
    [high, high_error] = limit_of(columns(11:20, :), at{:});

    a = reshape(alpha(here), 1, []);
    found = 3 * ones(size(a));
    found(a < low - low_error | a > high + high_error) = 2;
    found(a > low + low_error & a < high - high_error) = 1;
    is_beyond = ~is_inside(a, ends(3:4));
    found(is_beyond) = -1;
    found(is_beyond & isfinite(a) & atlas.whole(k) >= 1) = 2;
    code(here) = found;
    if atlas.whole(k) == 2
      code(cells == k & delay <= ends(2) & ~is_inside(point{1}, ends(5:6)) & ...
           is_inside(point{2}, atlas.gamma) & is_inside(point{3}, atlas.delta) & ...
           isfinite(point{1}) & isfinite(alpha)) = 2;
    end

    is_below = low + low_error <= ends(3); % beyond the alphas of the atlas they say nothing
    is_above = high - high_error >= ends(4);
    low(is_below) = -Inf;
    low_error(is_below) = 0;
    high(is_above) = Inf;
    high_error(is_above) = 0;
    high(low == Inf) = NaN;
    low(low == Inf) = NaN;
    lower(here) = low;
    lower_error(here) = low_error;
    upper(here) = high;
    upper_error(here) = high_error;
  end
end

function inside = is_inside(values, nodes)
  inside = values >= nodes(1) & values <= nodes(end);
end

function cells = cells_of(atlas, nodes, beta, gamma, delta)
% The numbers of the columns that hold points; in the file the cells along delta change fastest.
  count = atlas.cells(1);
  along_beta = min(floor((beta - nodes(1)) * (count / (nodes(end) - nodes(1)))), count - 1);
  cells = along_beta * atlas.cells(2) + cell_of(gamma, atlas.gamma);
  cells = cells * atlas.cells(3) + cell_of(delta, atlas.delta) + 1;
end

function cells = cell_of(values, nodes)
% The cell between nodes, from 0: an inner node belongs to the cell above it.
  cells = zeros(size(values));
  for node = nodes(2:end - 1)
    cells = cells + (values >= node);
  end
end

function [limit, limit_error] = limit_of(terms, beta, gamma, delta, delay)
  rate = terms(5, :) + terms(6, :) .* delay + terms(7, :) .* beta + terms(8, :) .* gamma + terms(9, :) .* delta;
  limit = terms(1, :) + terms(2, :) .* beta + terms(3, :) .* gamma + terms(4, :) .* delta + rate .* delay;
  limit_error = terms(10, :);
end

function atlas = opened(file)
  [image, head, shapes, places] = table_of(file);
  if isempty(regexp(head, '^jaxstab atlas 3\n', 'once'))
    error('jaxstab:version', ['%s has another schema version than 3, or none; use another ', ...
                              'reader, or build it again.'], file);
  elseif isempty(strfind(head, [sprintf('\ncontent '), sprintf('%02x', sha256(shapes))]))
    refuse_damaged(file);
  elseif isempty(regexp(shapes, '(^|\n)alpha_limits ', 'once'))
    error('jaxstab:product', ...
          '%s holds no limits of alpha; build one with the product ''alpha_limits''.', file);
  end
  filters = regexp(head, '\nfilters ([ -~]+)\n', 'tokens', 'once');
  if isempty(filters)
    refuse_damaged(file);
  end
  names = {'gamma', 'delta', 'limit_range', 'limit_whole', 'alpha_limits'};
  kinds = {'double', 'double', 'double', 'int32', 'single'};
  ranks = [1, 1, 2, 1, 5];
  for i = 1:5
    [values, is_read] = array_of(image, shapes, places, names{i}, kinds{i}, ranks(i));
    if ~is_read
      refuse_damaged(file);
    end
    raw.(names{i}) = values;
  end

  % The dimensions of arrays are reversed here.
  limits = raw.alpha_limits;
  atlas = struct('gamma', raw.gamma', 'delta', raw.delta', 'range', raw.limit_range', ...
                 'whole', double(raw.limit_whole'), ...
                 'filters', filters{1});
  atlas.cells = [size(limits, 5), size(limits, 4), size(limits, 3)];
  atlas.limits = reshape(limits, size(limits, 1), size(limits, 2), []);
  if ~may_be(atlas)
    refuse_damaged(file);
  end
end

function yes = may_be(atlas)
% Whether shapes and axes fit together, and all numbers may be.
  hands = max([numel(atlas.gamma), numel(atlas.delta)] - 1, 1);
  yes = isequal(size(atlas.whole), [1, size(atlas.range, 1)]) && ...
        all(atlas.whole >= 0 & atlas.whole <= 2) && size(atlas.limits, 1) == 20 && size(atlas.range, 2) == 6 && ...
        size(atlas.limits, 2) == size(atlas.range, 1) && isequal(atlas.cells(2:3), hands);
  for axis = {atlas.gamma, atlas.delta}
    yes = yes && all(isfinite(axis{1})) && all(diff(axis{1}) > 0) && axis{1}(1) >= 0;
  end
  if yes
    ends = atlas.range;
    spans = ends(:, [4, 6]) - ends(:, [3, 5]);
    largest = max(abs(ends(:, [4, 6])), abs(ends(:, [3, 5])));
    slopes = atlas.limits([2:9, 12:19], :);
    errors = atlas.limits([10, 20], :);
    yes = all(isfinite(ends(:))) && ends(1, 1) >= 0 && ends(end, 2) <= 100 && ...
          all(ends(:, 1) <= ends(:, 2)) && all(ends(1:end - 1, 2) <= ends(2:end, 1)) && ...
          all(diff(ends(:, 1)) > 0) && all(isfinite(spans(:))) && all(spans(:) >= max(1e-300, 2^-24 * largest(:))) && ...
          all(isfinite(slopes(:))) && all(errors(:) >= 0) && ~any(isnan(atlas.limits(:)));
  end
end

function [image, head, shapes, places] = table_of(file)
% The bytes of the HDF5 image, and the three blocks of the table after it.
  stream = -1;
  if is_file(file)
    stream = fopen(file, 'r');
  end
  if stream < 0
    error('jaxstab:file', '%s cannot be read.', file);
  end
  bytes = fread(stream, Inf, '*uint8')';
  fclose(stream);
  count = numel(bytes) - 48;
  if count < 0 || ~isequal(bytes(count + (1:8)), uint8(sprintf('jaxstab\n'))) || ...
     ~isequal(bytes(count + (17:48)), sha256(char(bytes(1:count))))
    refuse_damaged(file);
  end
  extent = double(bytes(count + (9:16))) * (256 .^ (0:7))';
  if extent > count
    refuse_damaged(file);
  end
  table = bytes(extent + 1:count);
  if any(table > 127) || sum(table == 10) > 200
    refuse_damaged(file);
  end
  image = bytes(1:extent);
  blocks = regexp(char(table), '\n\n', 'split');
  head = [blocks{1}, sprintf('\n')];
  if numel(blocks) == 3
    shapes = [blocks{2}, sprintf('\n')];
    places = blocks{3};
  elseif isempty(regexp(head, '^jaxstab atlas 3\n', 'once'))
    [shapes, places] = deal('');
  else
    refuse_damaged(file);
  end
end

function [values, is_read] = array_of(image, shapes, places, name, kind, rank)
% An array of numbers of a kind, double, single or int32, from its chunks; not read where they are not what their digests say.
  values = [];
  is_read = false;
  width = 4 * (1 + strcmp(kind, 'double'));
  letter = 'f';
  if strcmp(kind, 'int32')
    letter = 'i';
  end
  number = '[1-9]\d{0,11}';
  shape = [number, repmat(['x', number], 1, rank - 1)];
  line = regexp(shapes, ['(?:^|\n)', name, ' <', letter, int2str(width), ' (', shape, ') (', shape, ') ([0-9a-f ]+)\n'], ...
                'tokens', 'once');
  where = regexp(places, ['(?:^|\n)', name, '((?: \d{1,12}\+\d{1,12})+)\n'], 'tokens', 'once');
  if isempty(line) || isempty(where)
    return
  end
  whole = [fliplr(sscanf(line{1}, '%fx')'), 1];
  part = [fliplr(sscanf(line{2}, '%fx')'), 1];
  along = ceil(whole ./ part);
  chunks = prod(along);
  size_of_chunk = width * prod(part) + 4;
  if any(part > whole) || chunks * size_of_chunk > numel(image) || ...
     numel(line{3}) ~= 65 * chunks - 1 || sum(where{1} == ' ') ~= chunks
    return
  end
  digests = reshape([line{3}, ' '], 65, [])';
  ranges = sscanf(where{1}, ' %f+%f', [2, Inf]);
  if any(ranges(2, :) ~= size_of_chunk) || any(sum(ranges, 1) > numel(image))
    return
  end
  values = zeros(whole, kind);
  for n = 1:chunks
    rest = n - 1;
    for i = 1:numel(whole)
      start = mod(rest, along(i)) * part(i);
      rest = floor(rest / along(i));
      inside{i} = 1:min(part(i), whole(i) - start);
      place{i} = start + inside{i};
    end
    bytes = image(ranges(1, n) + (1:size_of_chunk - 4));
    chunk = reshape(typecast(bytes, kind), part);
    chunk = chunk(inside{:});
    if ~strcmp(sprintf('%02x', sha256(char(typecast(chunk(:)', 'uint8')))), digests(n, 1:64))
      return
    end
    values(place{:}) = chunk;
  end
  is_read = true;
end

function refuse_damaged(file)
  error('jaxstab:damaged', ...
        '%s is damaged, or no jaxstab atlas; build it again or copy it anew.', file);
end

function digest = sha256(text)
  if is_octave()
    digest = uint8(sscanf(hash('sha256', text), '%2x')');
  else
    engine = java.security.MessageDigest.getInstance('SHA-256');
    digest = reshape(typecast(engine.digest(uint8(text)), 'uint8'), 1, []);
  end
end

function yes = is_file(file)
% Whether there is a file, and no pipe or device, which would be waited for.
  if is_octave()
    [status, failed] = stat(file);
    yes = ~failed && S_ISREG(status.mode);
  else
    yes = exist(file, 'file') == 2;
  end
end

function yes = is_octave()
  yes = exist('OCTAVE_VERSION', 'builtin') ~= 0;
end

function [code, lower, lower_error, upper, upper_error] = ...
    jaxstab_query(atlas, alpha, beta, gamma, delta, delay)
% Stability verdicts from a jaxstab atlas, in Octave 6 or MATLAB R2016b and newer.
%
%   atlas = jaxstab_query('atlas.h5')
%       checks the file, its SHA-256 included, and loads the limits of the stable alpha.
%
%   code = jaxstab_query(atlas, alpha, beta, gamma, delta, delay)
%       answers for points, arrays of one shape or scalars:
%         1 stable, 2 unstable (both proved), 3 undecided: too close to the boundary for the atlas,
%        -1 NaN, outside of the atlas, or not one of its delays: it says nothing.
%
%   [code, lower, lower_error, upper, upper_error] = jaxstab_query(...)
%       gives the limits of the stable alpha too, which do not depend on the alpha asked about.
%       Every alpha from lower + lower_error to upper - upper_error is stable, and every one below
%       lower - lower_error or above upper + upper_error in the atlas is unstable. Where none is
%       stable both are NaN with an error of 0; an infinite limit is beyond the atlas, and with an
%       infinite error nothing is known.
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
  for k = 1:numel(atlas.delay)
    walls = {atlas.alpha(k, :), atlas.beta(k, :)};
    here = find(delay == atlas.delay(k) & is_inside(point{1}, walls{2}) & ...
                is_inside(point{2}, atlas.gamma) & is_inside(point{3}, atlas.delta));
    at = cellfun(@(values) reshape(values(here), 1, []), point, 'UniformOutput', false);
    columns = atlas.planes(:, k, cells_of(atlas, walls{2}, at{:}));
    [low, low_error] = plane(columns(1:5, :), at{:});
    [high, high_error] = plane(columns(6:10, :), at{:});

    a = reshape(alpha(here), 1, []);
    found = 3 * ones(size(a));
    found(a < low - low_error | a > high + high_error) = 2;
    found(a > low + low_error & a < high - high_error) = 1;
    found(~is_inside(a, walls{1})) = -1;
    code(here) = found;

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

function [limit, limit_error] = plane(terms, beta, gamma, delta)
  limit = terms(1, :) + terms(2, :) .* beta + terms(3, :) .* gamma + terms(4, :) .* delta;
  limit_error = terms(5, :);
end

function atlas = opened(file)
  check_bytes(file);
  names = {'alpha', 'beta', 'gamma', 'delta', 'delay', 'alpha_limits'};
  if is_octave()
    raw = load('-hdf5', file, names{:});
  else
    raw = struct();
    for name = names(ismember(names, {h5info(file).Datasets.Name}))
      raw.(name{1}) = h5read(file, ['/', name{1}]);
    end
  end
  found = isfield(raw, names);
  if ~all(found(1:5))
    refuse_damaged(file);
  elseif ~found(6)
    error('jaxstab:product', ...
          '%s holds no limits of alpha; build one with the product ''alpha_limits''.', file);
  end

  % Both programs show an array of HDF5 with its dimensions reversed.
  atlas = struct('alpha', raw.alpha, 'beta', raw.beta);
  for name = {'gamma', 'delta', 'delay'}
    atlas.(name{1}) = reshape(raw.(name{1}), 1, []);
  end
  hands = max([numel(atlas.gamma), numel(atlas.delta)] - 1, 1);
  count = numel(raw.alpha_limits) / (10 * numel(atlas.delay) * prod(hands));
  atlas.cells = [count, hands];
  atlas.planes = reshape(raw.alpha_limits, 10, numel(atlas.delay), []);
end

function check_bytes(file)
% Refuse a file without the right footer, or of another version of the schema.
  stream = fopen(file, 'r');
  if stream < 0
    error('jaxstab:file', '%s cannot be read.', file);
  end
  bytes = fread(stream, Inf, '*uint8')';
  fclose(stream);
  image = char(bytes(1:max(end - 48, 0)));
  length_bytes = mod(floor(numel(image) ./ 256 .^ (0:7)), 256);
  footer = [uint8(sprintf('jaxstab\n')), uint8(length_bytes), sha256(image)];
  if ~isequal(bytes(numel(image) + 1:end), footer) || isempty(strfind(image, 'jaxstab atlas'))
    refuse_damaged(file);
  end
  % Octave shows no attributes, so this is schema_version as it lies in the file: name, type (int32,
  % little endian), space (one value) and value, which is 2 or 3.
  head = [uint8('schema_version'), 0, 16, 8, 0, 0, 4, 0, 0, 0, 0, 0, 32, 0, 2, 0, 0, 0];
  at = strfind(image, char(head)) + numel(head);
  if numel(at) ~= 1 || ~any(image(at) == [2, 3]) || any(image(at + (1:3)) ~= 0)
    error('jaxstab:version', ...
          '%s has a schema version other than 2 and 3; use another reader, or build it again.', ...
          file);
  end
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

function yes = is_octave()
  yes = exist('OCTAVE_VERSION', 'builtin') ~= 0;
end

% The crank-rocker of problems/crank-rocker.toml for Octave's sqp, as one would write it down; timed in process.
% Prints one line per variant: name, median seconds, coupler [mm], rocker [mm], objective [rad^2].
1;  % a script file, although functions come first

function [phi0, psi0] = outer_dead_centre(x)
  l1 = 100; l4 = 500; l2 = x(1); l3 = x(2);
  phi0 = acos(((l1 + l2)^2 - l3^2 + l4^2) / (2 * (l1 + l2) * l4));
  psi0 = acos(((l1 + l2)^2 - l3^2 - l4^2) / (2 * l3 * l4));
end

function f = objective_vectorised(x)
  l1 = 100; l4 = 500; l2 = x(1); l3 = x(2);
  [phi0, psi0] = outer_dead_centre(x);
  offset = (1:30)' * (pi / 2 / 30);
  bx = l4 - l1 * cos(phi0 + offset);  % from B to D
  by = l1 * sin(phi0 + offset);
  d = sqrt(bx.^2 + by.^2);
  psi = pi - atan2(by, bx) - acos((d.^2 + l3^2 - l2^2) ./ (2 * d * l3));
  f = sum((psi0 + 2 / (3 * pi) * offset.^2 - psi).^2);
end

function f = objective_loop(x)
  l1 = 100; l4 = 500; l2 = x(1); l3 = x(2);
  [phi0, psi0] = outer_dead_centre(x);
  f = 0;
  for i = 1:30
    offset = i * pi / 2 / 30;
    bx = l4 - l1 * cos(phi0 + offset);
    by = l1 * sin(phi0 + offset);
    d = sqrt(bx^2 + by^2);
    psi = pi - atan2(by, bx) - acos((d^2 + l3^2 - l2^2) / (2 * d * l3));
    f = f + (psi0 + 2 / (3 * pi) * offset^2 - psi)^2;
  end
end

function h = inequalities(x)
  l1 = 100; l4 = 500; l2 = x(1); l3 = x(2);
  h = [l2 - l1; l3 - l1; l4 - l1; l2 + l3 - l1 - l4; l3 + l4 - l1 - l2; l2 + l4 - l1 - l3;
       (l2^2 + l3^2 - (l4 + l1)^2) / (2 * l2 * l3) - cos(3 * pi / 4);
       cos(pi / 4) - (l2^2 + l3^2 - (l4 - l1)^2) / (2 * l2 * l3)];
end

function x = in_millimetres(objective)
  x = sqp([400; 400], objective, [], @inequalities, [100; 100], [900; 900]);
end

function x = scaled(objective)  % lengths over the frame, objective over its value at the start
  start = [400; 400] / 500;
  f0 = objective(500 * start);
  x = 500 * sqp(start, @(x) objective(500 * x) / f0, [], @(x) inequalities(500 * x), [0.2; 0.2], [1.8; 1.8]);
end

names = {"loop", "vectorised", "scaled"};
runs = {@() in_millimetres(@objective_loop), @() in_millimetres(@objective_vectorised), ...
        @() scaled(@objective_vectorised)};
repetitions = 25;
seconds = zeros(repetitions, numel(runs));
ends = cell(1, numel(runs));
for k = -2:repetitions  % the first three warm up
  for j = 1:numel(runs)
    clock = tic;
    ends{j} = runs{j}();
    if k > 0
      seconds(k, j) = toc(clock);
    end
  end
end
for j = 1:numel(runs)
  printf("%s %.9g %.9g %.9g %.9g\n", names{j}, median(seconds(:, j)), ends{j}, objective_vectorised(ends{j}));
end

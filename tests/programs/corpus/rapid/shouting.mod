MODULE SHOUTING
	CONST ROBTARGET P10:=<4|torch|wobj0>;
	const robtarget p20 := <5|torch|wobj0> ;
	Const RobTarget P30:=
		<6|torch|wobj0>
	;
	PROC MAIN()
		MOVEJ P10,V1000,FINE,TORCH;
		movel p20,v200,fine,torch\wobj:=wobj0;
		MoveL   P30 , v200 , z1 , Torch \WObj:=WObj0 ;
		MoveC P20, p10, v200, z1, torch ;
	ENDPROC
ENDMODULE
